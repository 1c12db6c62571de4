"""The schemes the letter compares with, through the same `plan` and `replan`."""

from collections.abc import Callable

import numpy as np
import pytest

from skyfolio.planner import EXAMPLES, Iteration, Scenario, StopToken, plan, replan, violations
from skyfolio.planner.layouts import scattered
from skyfolio.planner.scenario import NoFlyDisc, Utility

ByHand = Callable[..., Scenario]
SCHEMES = ["baseline1", "baseline2", "baseline2_fixed", "sr_max", "static"]


@pytest.fixture(scope="module")
def paper() -> Scenario:
    return EXAMPLES["paper"]()


@pytest.mark.parametrize("method", SCHEMES)
def test_each_scheme_plans_and_replans_feasibly_and_says_who_it_is(paper: Scenario, method: str) -> None:
    made = plan(paper, method=method)
    again = replan(made, failed=["uav-2"], at_slot=10)
    for each in (made, again):
        assert violations(each) == []
        assert each.method == method
        assert each.summary.upper_bound_bps >= each.summary.utility_bps
    assert set(again.trajectories_m) == {"uav-1", "uav-3"}


def test_their_sum_rates_are_in_the_letters_order(paper: Scenario) -> None:
    rates = {method: plan(paper, method=method).summary.mean_sum_rate_bps for method in SCHEMES}
    assert rates["baseline1"] < rates["baseline2"] < rates["sr_max"]
    assert rates["baseline1"] < rates["static"] < rates["sr_max"]


def test_baseline1_is_equal_shares_of_the_nearest_uav(two_uavs_four_users: ByHand) -> None:
    made = plan(two_uavs_four_users(), method="baseline1")
    for user, uav in (("user-1", "uav-1"), ("user-2", "uav-1"), ("user-3", "uav-2"), ("user-4", "uav-2")):
        assert made.association[user] == [uav] * 3
        assert made.bandwidth_hz[user] == [5_000.0] * 3
        assert made.user_rates_bps[user] == pytest.approx([15_000.0] * 3)
    assert [one.iteration for one in made.history] == [1]


def test_static_finds_the_60_kbps_worked_by_hand(two_uavs_four_users: ByHand) -> None:
    for kind in ("sum", "per_user", "pooled"):
        made = plan(two_uavs_four_users(kind=kind, mu=-0.3), method="static")
        assert made.summary.utility_bps == pytest.approx(60_000, rel=1e-4)


def test_the_a_and_b_of_sum_do_not_depend_on_mu_to_the_last_bit(paper: Scenario) -> None:
    """At the same paths: `sum` grows with each slot's sum rate, so only the trajectories can feel mu."""
    seen = []
    for mu in (0.0, -0.1, -10.0):
        made = plan(paper.with_changes(utility=Utility(kind="sum", mu_per_kbps=mu)), method="static")
        again = replan(made, failed=["uav-3"], at_slot=10, achieved_rates_bps={"user-1": [5e4] * 10})
        seen.append((made.association, made.bandwidth_hz, again.association, again.bandwidth_hz))
    assert seen[0] == seen[1] == seen[2]


def test_the_b_of_pooled_does_depend_on_mu(paper: Scenario) -> None:
    made = [
        plan(paper.with_changes(utility=Utility(kind="pooled", mu_per_kbps=mu)), method="static") for mu in (0.0, -0.3)
    ]
    assert made[0].bandwidth_hz != made[1].bandwidth_hz
    assert made[0].summary.jain < made[1].summary.jain


def test_baseline2_flies_at_most_d_max_to_its_places_and_then_hovers(paper: Scenario) -> None:
    made = plan(paper, method="baseline2")
    for path in made.trajectories_m.values():
        steps = np.linalg.norm(np.diff(np.array(path), axis=0), axis=1)
        moving = int((steps > 1e-6).sum())
        assert (steps[:moving] > 1e-6).all(), "it does not stop on its way"
        assert steps[moving:] == pytest.approx(np.zeros(len(steps) - moving), abs=1e-6)
        assert steps[: max(moving - 1, 0)] == pytest.approx(np.full(max(moving - 1, 0), 25.0), rel=1e-6)


def test_baseline2_can_be_stopped_and_watched(paper: Scenario) -> None:
    seen: list[Iteration] = []
    made = plan(paper, method="baseline2", observer=seen.append)
    assert seen == made.history
    utilities = [one.utility_bps for one in seen]
    assert utilities == sorted(utilities)
    stopped = plan(paper, method="baseline2", stop=StopToken(lambda: True))
    assert stopped.status == "cancelled"
    assert violations(stopped) == []


@pytest.mark.parametrize("method", SCHEMES)
def test_operators_constraints_hold_for_each_scheme(method: str) -> None:
    scenario = scattered(3, 6, 8, seed=2)
    east, north = scenario.uavs[0].start_m
    scenario = scenario.with_changes(
        uavs=(
            scenario.uavs[0].model_copy(update={"end_m": (east + 50.0, north), "altitude_m": 45.0}),
            scenario.uavs[1].model_copy(update={"leaves_at_slot": 5}),
            scenario.uavs[2],
        ),
        no_fly=(NoFlyDisc(center_m=(east + 25.0, north + 12.0), radius_m=10.0),),
    )
    assert violations(plan(scenario, method=method)) == []
