"""Hills between UAVs and users under every kind that knows what they cost."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import Plan, Scenario, delivered_rates_bps, plan, replan, violations
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.channels.rician import knife_edge_db
from skyfolio.planner.ground.bounding import bound_over_kbps
from skyfolio.planner.ground.ground import Ground, ground_of
from skyfolio.planner.ground.hidden import edges
from skyfolio.planner.ground.links import seen_aloft
from skyfolio.planner.ground.room import room_over
from skyfolio.planner.problem import problem_of
from skyfolio.planner.repair import within_limits
from skyfolio.planner.robustness.flown import flown_as_planned, planned_gains
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.terrain import Terrain
from tests.planner.hills import hill, over_the_hill

COUNTING: dict[str, dict[str, Any]] = {
    "rician": {"carrier_hz": 2e9, "noise_dbm": -60.0},
    "rician, dipole": {"carrier_hz": 2e9, "noise_dbm": -60.0, "antenna": {"kind": "dipole"}},
    "los_probability": {"kind": "los_probability", "noise_figure_db": 9.0},
    "3gpp_uav": {"kind": "3gpp_uav", "environment": "RMa-AV", "noise_figure_db": 9.0},
}


def hilly(name: str, **changes: Any) -> Scenario:
    return over_the_hill(**{"channel": channel_of(COUNTING[name]), "altitude_m": 40.0, **changes})


@pytest.mark.parametrize(("v", "loss_db"), [(-2.0, 0.0), (0.0, 6.033), (1.0, 13.926), (2.4, 20.538)])
def test_a_knife_edge_costs_what_p_526_says(v: float, loss_db: float) -> None:
    assert knife_edge_db(np.array(v)) == pytest.approx(loss_db, abs=2e-3)


def test_the_edge_of_a_ridge_is_worked_out_as_by_hand() -> None:
    row = tuple(400.0 + 100.0 * (column == 10) for column in range(21))  # a ridge at 250 m, 100 m high
    ridge = Terrain(south_west_m=(0.0, 0.0), spacing_m=25.0, heights_m=(row,) * 21)
    user, uav = np.array([[[50.0, 200.0]]]), np.array([[[450.0, 200.0]]])
    ray_m = 1.5 + 0.5 * (60.0 - 1.5)
    by_hand = (100.0 - ray_m) * math.sqrt(2.0 * (1.0 / 200.0 + 1.0 / 200.0))
    assert edges(ridge, user, uav, np.full((1, 1, 1), 60.0))[0, 0, 0] == pytest.approx(by_hand, rel=1e-12)
    beside = np.array([[[200.0, 300.0]]])
    assert edges(ridge, user, beside, np.full((1, 1, 1), 60.0))[0, 0, 0] < 0.0


def first_gain_db(scenario: Scenario, at_m: tuple[float, float], altitude_m: float) -> tuple[float, float]:
    """Return the gain from a UAV there to the first user as plans see it, and the one without hills."""
    ground = ground_of(scenario)
    assert ground is not None
    problem = problem_of(scenario)
    paths = np.broadcast_to(np.array(at_m), problem.hover().shape).copy()
    altitudes = np.full(paths.shape[:2], altitude_m)
    return tuple(
        10.0 * math.log10(seen.snr(paths)[0, 0, 0])
        for seen in (
            seen_aloft(problem, ground, paths, altitudes),
            seen_aloft(problem, without_hills(ground), paths, altitudes),
        )
    )  # type: ignore[return-value]


def without_hills(ground: Ground) -> Ground:
    return replace(ground, terrain=Terrain.flat(400.0))


def test_behind_the_hill_a_link_has_the_loss_without_line_of_sight() -> None:
    scenario = hilly("los_probability")
    hidden, clear = first_gain_db(scenario, (60.0, 250.0), 450.0)
    theta = math.degrees(math.atan2(450.0 - scenario.terrain.height_at(440.0, 250.0), 380.0))  # type: ignore[union-attr]
    probability = 1.0 / (1.0 + 9.61 * math.exp(-0.16 * (theta - 9.61)))
    assert clear - hidden == pytest.approx(probability * 19.0, abs=1e-6)
    above, as_above = first_gain_db(scenario, (60.0, 250.0), 900.0)
    assert above == pytest.approx(as_above, abs=1e-9)


def test_behind_the_hill_the_letters_channel_loses_what_diffraction_costs() -> None:
    scenario = hilly("rician")
    hidden, clear = first_gain_db(scenario, (60.0, 250.0), 450.0)
    terrain = scenario.terrain
    assert terrain is not None
    foot = terrain.height_at(440.0, 250.0) + 1.5
    v = max(
        (terrain.height_at(440.0 - 25.0 * n + 10.0, 250.0) - foot - (25.0 * n - 10.0) / 380.0 * (450.0 - foot))
        * math.sqrt(2.0 / 0.149896229 * 380.0 / ((25.0 * n - 10.0) * (390.0 - 25.0 * n)))
        for n in range(1, 15)
    )  # the line runs along a row of the grid, over its places at 425, 400 ... m east
    assert v > 1.0
    assert clear - hidden == pytest.approx(6.9 + 20.0 * math.log10(math.sqrt((v - 0.1) ** 2 + 1.0) + v - 0.1), abs=0.01)


def test_hills_do_not_count_for_the_letters_channel_without_a_carrier() -> None:
    scenario = over_the_hill()
    hidden, clear = first_gain_db(scenario, (60.0, 250.0), 450.0)
    assert hidden == pytest.approx(clear, abs=1e-9)


@pytest.mark.parametrize("name", COUNTING)
def test_plans_over_hills_are_feasible_and_promise_what_is_delivered(name: str) -> None:
    made = plan(hilly(name), n_starts=4)
    assert violations(made) == []
    assert made.summary.utility_bps <= made.summary.upper_bound_bps
    planned = np.array([made.user_rates_bps[user] for user in made.scenario.user_ids])
    assert pytest.approx(planned, rel=1e-6, abs=1e-3) == delivered(made).T
    assert flown_as_planned(made).rates_bps(planned_gains(made)) == pytest.approx(planned, rel=1e-6, abs=1e-3)
    assert violations(replan(made, failed=["south"], at_slot=4)) == []


def delivered(made: Plan) -> Any:
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    slots = np.arange(made.scenario.slots)
    return delivered_rates_bps(made, slots, paths.transpose(1, 0, 2), np.ones((len(slots), len(paths)), dtype=bool))


@pytest.mark.parametrize("name", COUNTING)
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31))
def test_no_random_plan_over_hills_is_better_than_the_bound(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = {"altitude_min_m": 30.0, "altitude_max_m": 90.0} if seed % 2 else {}
    scenario = hilly(name, slots=5, terrain=hill(float(rng.uniform(0.0, 200.0))), **limits)
    ground, problem = ground_of(scenario), problem_of(scenario)
    assert ground is not None
    bound = bound_over_kbps(problem, ground)
    for _ in range(3):
        steps = np.linspace(0, 1, problem.n_slots)[:, None] * rng.normal(size=(2, 1, 2)) * 80
        paths = within_limits(problem, problem.hover() + steps)
        room = room_over(ground, paths)
        top = np.minimum(room.ceiling_m, room.floor_m + 60.0)
        altitudes = room.floor_m + (rng.random() * (top - room.floor_m) if limits else 0.0)
        seen = seen_aloft(problem, ground, paths, altitudes)
        pairs = problem.bandwidth_hz[:, None, None] * spectral_efficiency(seen, paths) / 1e3
        share = np.zeros(pairs.shape)
        for n in range(problem.n_slots):
            first, second = rng.choice(problem.n_users, 2, replace=False)
            share[0, first, n] = share[1, second, n] = 1.0
        assert problem.utility_kbps((share * pairs).sum(axis=0)) <= bound * (1 + 1e-9)
