"""The schemes the letter compares with."""

from itertools import product

import numpy as np
import pytest

from planner import EXAMPLES, METHODS, Utility, plan, replan, violations
from planner.channel import spectral_efficiency
from planner.problem import problem_of
from planner.scenario import Scenario

BASELINES = ("static", "baseline1", "baseline2", "sr_max")


@pytest.fixture(scope="module")
def paper() -> Scenario:
    return EXAMPLES["paper"]()


@pytest.mark.parametrize("method", BASELINES)
def test_every_baseline_plans_and_replans_feasibly_by_name(method: str, paper: Scenario) -> None:
    made = plan(paper, method=method)
    assert made.method == method
    assert violations(made) == []
    again = replan(made, failed=["uav-2"], at_slot=10)
    assert again.method == method
    assert violations(again) == []
    assert len(made.history) >= 1


def test_baseline_1_splits_the_band_of_the_nearest_uav_equally(paper: Scenario) -> None:
    made = plan(paper, method="baseline1")
    places = np.array([uav.start_m for uav in paper.uavs])
    for user in paper.users:
        nearest = paper.uav_ids[int(np.linalg.norm(places - user.position_m, axis=1).argmin())]
        assert set(made.association[user.id]) == {nearest}
        sharing = sum(row[0] == nearest for row in made.association.values())
        assert made.bandwidth_hz[user.id] == pytest.approx([10_000 / sharing] * paper.slots)
    assert all(set(path) == {paper.uav(uav).start_m} for uav, path in made.trajectories_m.items())


def test_static_is_the_best_pairing_at_the_start_positions() -> None:
    scenario = EXAMPLES["minimal"]().with_changes(utility=Utility())
    made = plan(scenario, method="static")
    problem = problem_of(scenario)
    efficiency = spectral_efficiency(problem, problem.hover())[:, :, 0]
    pairs = [efficiency[0, a] + efficiency[1, b] for a, b in product(range(4), repeat=2) if a != b]
    best = float(max(pairs)) * 10_000
    assert made.summary.mean_sum_rate_bps == pytest.approx(best, rel=1e-12)


def test_baseline_2_flies_straight_to_its_place_and_beats_staying(paper: Scenario) -> None:
    made = plan(paper, method="baseline2")
    for path in made.trajectories_m.values():
        points = np.array(path)
        way = points[-1] - points[0]
        off = points - points[0]
        assert np.abs(off[:, 0] * way[1] - off[:, 1] * way[0]).max() < 1e-6 * max(float(way @ way), 1.0)
        assert np.allclose(points[-1], points[-2])
    assert made.summary.mean_sum_rate_bps > plan(paper, method="baseline1").summary.mean_sum_rate_bps


def test_sr_max_is_the_planner_without_a_penalty(paper: Scenario) -> None:
    steady = paper.with_changes(utility=Utility(kind="pooled", mu_per_kbps=-1.0))
    greedy = paper.with_changes(utility=Utility())
    assert plan(steady, method="sr_max").trajectories_m == plan(greedy, method="fast").trajectories_m


def test_an_unknown_method_is_refused_with_the_names_there_are(paper: Scenario) -> None:
    with pytest.raises(ValueError, match="method: 'best' must be one of"):
        plan(paper, method="best")
    assert set(BASELINES) < set(METHODS)
