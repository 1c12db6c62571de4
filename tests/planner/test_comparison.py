"""A changed scenario compared with a plan."""

import numpy as np
import pytest

from skyfolio.planner import Changes, Plan, Uav, User, letter, plan, preview, replan
from skyfolio.planner.comparison import compare


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(letter())


def test_a_plan_compared_with_itself_has_no_change(made: Plan) -> None:
    same = compare(made, made)
    assert (same.gaining, same.losing, same.joined, same.left) == ((), (), (), ())
    assert set(same.unchanged) == set(made.scenario.user_ids)
    assert {move.greatest_m for move in same.uavs} == {0.0}
    assert same.utility_before_bps == same.utility_after_bps
    assert same.mean_sum_rate_before_bps == pytest.approx(made.summary.mean_sum_rate_bps)


def test_a_wider_band_in_a_changed_scenario_gains_what_an_independent_plan_gains(made: Plan) -> None:
    first, *others = made.scenario.uavs
    wider = made.scenario.with_changes(uavs=(first.model_copy(update={"bandwidth_hz": 20_000.0}), *others))
    seen = preview(made, scenario=wider)
    independent = plan(wider)
    assert seen.method == "resolve"
    assert seen.utility_before_bps == made.summary.utility_bps
    assert seen.utility_after_bps == pytest.approx(independent.summary.utility_bps, rel=5e-3)
    assert seen.utility_after_bps <= seen.upper_bound_after_bps
    assert seen.gaining
    changes = (*seen.gaining, *seen.losing)
    total = sum(one.gain_bps or 0.0 for one in changes)
    assert seen.mean_sum_rate_after_bps - seen.mean_sum_rate_before_bps == pytest.approx(total, abs=9.0)


def test_other_users_and_uavs_are_told_apart_from_those_that_gain_and_lose(made: Plan) -> None:
    users = (*made.scenario.users[1:], User(id="newcomer", position_m=(250.0, 250.0)))
    uavs = (*made.scenario.uavs[1:], Uav(id="uav-9", start_m=(20.0, 20.0)))
    seen = preview(made, scenario=made.scenario.with_changes(users=users, uavs=uavs))
    assert [one.user_id for one in seen.left] == ["user-1"]
    assert [one.user_id for one in seen.joined] == ["newcomer"]
    moves = {move.uav_id: move for move in seen.uavs}
    assert (moves["uav-1"].mean_m, moves["uav-1"].flown_after_m) == (None, None)
    assert moves["uav-1"].flown_before_m is not None
    assert (moves["uav-9"].mean_m, moves["uav-9"].flown_before_m) == (None, None)
    assert moves["uav-2"].mean_m is not None


@pytest.mark.parametrize("slots", [10, 20, 30])
def test_scenarios_of_another_length_are_compared_on_the_slots_that_both_have(made: Plan, slots: int) -> None:
    seen = preview(made, scenario=made.scenario.with_changes(slots=slots))
    assert (seen.first_slot, seen.slots) == (0, min(slots, 20))


def test_changes_are_compared_from_their_slot_on_with_what_a_replan_gives(made: Plan) -> None:
    changes = Changes(users_left=("user-2",), failed=("uav-3",))
    seen = preview(made, at_slot=8, changes=changes)
    again = replan(made, at_slot=8, changes=changes)
    assert (seen.first_slot, seen.slots) == (8, 12)
    assert seen.utility_after_bps == again.summary.utility_bps
    assert seen.mean_sum_rate_after_bps == pytest.approx(again.summary.mean_sum_rate_bps)
    before = {user: float(np.mean(rates[8:])) for user, rates in made.user_rates_bps.items()}
    assert [one.user_id for one in seen.left] == ["user-2"]
    for one in (*seen.gaining, *seen.losing):
        assert one.before_bps == pytest.approx(before[one.user_id])
        assert one.after_bps == pytest.approx(float(np.mean(again.user_rates_bps[one.user_id])))


def test_the_past_of_a_replan_counts_in_a_changed_scenario_too(made: Plan) -> None:
    again = replan(made, failed=["uav-3"], at_slot=8)
    seen = preview(again, scenario=again.scenario)
    assert (seen.first_slot, seen.slots) == (8, 12)
    assert seen.utility_after_bps == pytest.approx(again.summary.utility_bps, rel=5e-3)
    newcomer = User(id="newcomer", position_m=(250.0, 250.0))
    joined = preview(again, scenario=again.scenario.with_changes(users=(*again.scenario.users, newcomer)))
    assert [one.user_id for one in joined.joined] == ["newcomer"]


def test_hand_overs_are_counted_where_both_plans_serve_the_user(made: Plan) -> None:
    other = made.model_copy(
        update={"association": {user: ["uav-1"] * 20 for user in made.scenario.user_ids}},
    )
    seen = compare(made, other)
    expected = {
        user: sum(uav != "uav-1" and rate > 0 for uav, rate in zip(row, made.user_rates_bps[user], strict=True))
        for user, row in made.association.items()
    }
    assert sum(expected.values()) > 0
    assert seen.hand_overs == {user: slots for user, slots in expected.items() if slots}


def test_plans_without_a_common_slot_are_refused(made: Plan) -> None:
    with pytest.raises(ValueError, match="none in common"):
        compare(made, made.model_copy(update={"first_slot": 20}))
