"""Replans for whatever can change in an operation."""

import numpy as np
import pytest

from skyfolio.planner import (
    Changes,
    Past,
    Plan,
    ReplanError,
    Uav,
    User,
    Utility,
    plan,
    remaining,
    replan,
    violations,
)
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import NoFlyDisc
from skyfolio.planner.utility import utility_kbps


def test_any_set_of_uavs_may_fail_but_not_all(flown: Plan) -> None:
    again = replan(flown, failed=["uav-1", "uav-3"], at_slot=7, n_starts=2)
    assert list(again.trajectories_m) == ["uav-2"]
    assert again.cause.uav_ids == ("uav-1", "uav-3")
    assert violations(again) == []
    with pytest.raises(ReplanError, match="failed: no UAV would be left"):
        replan(flown, failed=["uav-1", "uav-2"], changes=Changes(failed=("uav-3",)), at_slot=7)


def test_a_replan_begins_at_the_live_positions_and_counts_what_was_achieved(flown: Plan) -> None:
    achieved = {user: [1e3] * 7 for user in flown.scenario.user_ids}
    again = replan(
        flown, failed=["uav-1"], at_slot=7, positions_m={"uav-2": (360.0, 350.0)}, achieved_rates_bps=achieved
    )
    assert again.trajectories_m["uav-2"][0] == (360.0, 350.0)
    assert again.achieved_rates_bps == achieved
    assert (again.first_slot, again.parent, again.revision, again.scenario.slots) == (7, flown.id, 2, 13)


def test_a_returning_uav_takes_part_from_where_it_is(flown: Plan) -> None:
    without = replan(flown, failed=["uav-3"], at_slot=4, n_starts=2)
    back = Uav(id="uav-3", start_m=(300.0, 200.0))
    again = replan(without, at_slot=8, changes=Changes(returned=(back,)), n_starts=2)
    assert again.trajectories_m["uav-3"][0] == (300.0, 200.0)
    assert again.cause.kind == "uav_returned"
    assert violations(again) == []
    with pytest.raises(ReplanError, match="returned: 'uav-3' is still flying"):
        replan(flown, at_slot=8, changes=Changes(returned=(back,)))


def test_a_user_that_joins_has_no_past_and_one_that_leaves_no_longer_counts(flown: Plan) -> None:
    new = User(id="guest", position_m=(250.0, 250.0))
    changes = Changes(users_joined=(new,), users_left=("user-1",))
    again = replan(flown, at_slot=5, changes=changes, n_starts=2)
    assert again.achieved_rates_bps["guest"] == []
    assert "user-1" not in again.user_rates_bps
    assert again.cause.kind == "users_changed"
    assert violations(again) == []
    scenario, past = remaining(flown, [], 5, changes=changes)
    problem = problem_of(scenario, past)
    rates = [[rate / 1e3 for rate in again.user_rates_bps[user]] for user in scenario.user_ids]
    worth = utility_kbps(problem.counted_kbps(np.array(rates)), "per_user", problem.mu)
    assert again.summary.utility_bps == pytest.approx(worth * 1e3, rel=1e-9)
    assert again.summary.utility_bps == pytest.approx(again.history[-1].utility_bps, rel=1e-9)
    later = replan(again, at_slot=9, failed=["uav-1"], n_starts=1)
    assert len(later.achieved_rates_bps["guest"]) == 4
    assert len(later.achieved_rates_bps["user-2"]) == 9


def test_mu_and_bands_can_change_in_flight(flown: Plan) -> None:
    changes = Changes(utility=Utility(kind="sum", mu_per_kbps=0.0), bandwidth_hz={"uav-1": 20_000.0})
    again = replan(flown, at_slot=5, changes=changes)
    assert again.scenario.utility.kind == "sum"
    assert again.scenario.uav("uav-1").bandwidth_hz == 20_000.0
    assert again.cause.kind == "retuned"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (Changes(failed=("uav-9",)), "failed: 'uav-9' is not a UAV"),
        (Changes(users_left=("nobody",)), "users_left: 'nobody' is not a user"),
        (Changes(users_joined=(User(id="user-1", position_m=(0.0, 0.0)),)), "users_joined: 'user-1' is already there"),
        (Changes(bandwidth_hz={"uav-9": 1.0}), "bandwidth_hz: 'uav-9' is not a UAV"),
        (Changes(users_left=tuple(f"user-{k}" for k in range(1, 10))), "users_left: no user would be left"),
    ],
)
def test_changes_that_make_no_sense_are_refused_by_name(flown: Plan, changes: Changes, message: str) -> None:
    with pytest.raises(ReplanError, match=message):
        replan(flown, at_slot=5, changes=changes)


def test_a_uav_blown_into_a_zone_is_planned_from_its_edge(flown: Plan) -> None:
    zone = NoFlyDisc(center_m=(200.0, 200.0), radius_m=20.0)
    made = plan(flown.scenario.with_changes(no_fly=(zone,)), n_starts=1)
    again = replan(made, failed=["uav-1"], at_slot=3, positions_m={"uav-2": (215.0, 200.0)}, n_starts=1)
    assert again.trajectories_m["uav-2"][0] == pytest.approx((220.0, 200.0), abs=1e-5)
    assert violations(again) == []


def test_the_fixed_slots_of_an_excluding_utility_keep_the_past_whole(flown: Plan) -> None:
    utility = Utility(kind="per_user", mu_per_kbps=-0.1, exclude_fixed_slots=True)
    made = plan(flown.scenario.with_changes(utility=utility), n_starts=1)
    again = replan(replan(made, failed=["uav-1"], at_slot=4, n_starts=1), at_slot=6, n_starts=1)
    assert {len(row) for row in again.achieved_rates_bps.values()} == {6}


def test_past_rates_of_the_wrong_shape_are_refused(flown: Plan) -> None:
    with pytest.raises(ValueError, match=r"past.rates_bps has 2 rows"):
        plan(flown.scenario, past=Past(first_slot=1, rates_bps=np.zeros((2, 1))))
