"""The schedule keeper by itself: what it orders in situations worked by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from mavlink_bridge import Autopilot, OnEnd, compile_mission
from mavlink_bridge.keeper import Keeper
from mavlink_bridge.models import ARDUCOPTER, PX4
from planner.plans import Plan

PlanOf = Callable[..., Plan]
PATH = [(0.0, 0.0), (0.0, 20.0), (0.0, 40.0), (0.0, 40.0), (0.0, 40.0), (20.0, 40.0), (40.0, 40.0)]


@pytest.fixture
def keeper(plan_of: PlanOf) -> Keeper:
    mission = compile_mission(plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD)
    return Keeper(PATH, 5.0, mission, PX4)


def item_at(plan_of: PlanOf, slot: int) -> int:
    mission = compile_mission(plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD)
    return next(seq for seq, first in mission.slot_of_item.items() if first == slot)


def test_one_that_is_late_is_told_to_fly_faster_and_one_that_is_early_slower(plan_of: PlanOf) -> None:
    speeds = []
    for north in (14.0, 20.0, 26.0):
        mission = compile_mission(plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD)
        order = Keeper(PATH, 5.0, mission, PX4).advise(5.5, (0.0, north), (0.0, 4.0), item_at(plan_of, 2))
        assert order is not None
        assert order.speed_mps is not None
        speeds.append(order.speed_mps)
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[0] > 5.0 > speeds[2]


def test_one_that_is_kept_from_the_middle_of_a_flight_on_has_no_slip_of_the_slots_before(plan_of: PlanOf) -> None:
    mission = compile_mission(plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD)
    keeper = Keeper(PATH, 5.0, mission, PX4, since_s=12.0)
    assert keeper.slip(14.9, (0.0, 40.0)) is None
    slip = keeper.slip(15.1, (0.0, 39.0))
    assert slip is not None
    assert (slip.slot, slip.distance_m) == (3, 1.0)


def test_orders_stay_within_the_vehicles_limits(keeper: Keeper, plan_of: PlanOf) -> None:
    order = keeper.advise(9.5, (0.0, -400.0), (0.0, 0.0), item_at(plan_of, 1))
    assert order is not None
    assert order.speed_mps == PX4.max_speed_mps


def test_a_hold_that_began_late_is_cut_short_when_its_slot_is_over(keeper: Keeper, plan_of: PlanOf) -> None:
    hovering = item_at(plan_of, 2)
    assert keeper.advise(19.0, (0.0, 40.0), (0.0, 0.0), hovering) is None
    order = keeper.advise(20.0, (0.0, 40.0), (0.0, 0.0), hovering)
    assert order is not None
    assert order.item == hovering + 1
    assert keeper.advise(21.0, (0.0, 40.0), (0.0, 0.0), hovering) is None  # said once


def test_one_that_is_still_on_its_way_to_a_hold_does_not_skip_it(keeper: Keeper, plan_of: PlanOf) -> None:
    order = keeper.advise(21.0, (0.0, 20.0), (0.0, 4.0), item_at(plan_of, 2))
    assert order is not None
    assert order.item is None


def test_orders_are_not_repeated_more_than_twice_a_second(keeper: Keeper, plan_of: PlanOf) -> None:
    at = item_at(plan_of, 1)
    assert keeper.advise(1.0, (0.0, 0.0), (0.0, 0.0), at) is not None
    assert keeper.advise(1.3, (0.0, 0.0), (0.0, 0.0), at) is None


def test_nothing_is_ordered_after_the_last_slot_began(keeper: Keeper, plan_of: PlanOf) -> None:
    assert keeper.advise(30.0, (0.0, 0.0), (0.0, 0.0), item_at(plan_of, 6)) is None


def test_slip_is_told_once_a_slot_in_metres_and_seconds(keeper: Keeper) -> None:
    assert keeper.slip(4.9, (0.0, 12.0)) is None
    slip = keeper.slip(5.0, (0.0, 12.0))
    assert slip is not None
    assert (slip.slot, slip.distance_m) == (1, 8.0)
    assert slip.late_s == pytest.approx(2.0)
    assert keeper.slip(5.1, (0.0, 12.0)) is None
    early = keeper.slip(10.0, (0.0, 44.0))
    assert early is not None
    assert early.late_s == pytest.approx(-1.0)


def test_arducopters_whole_second_holds_leave_the_rest_to_the_next_leg(plan_of: PlanOf) -> None:
    mission = compile_mission(
        plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD, autopilot=Autopilot.ARDUPILOT, model=ARDUCOPTER
    )
    holds = [mission.items[seq].param1 for seq in mission.slot_of_item]
    assert all(hold == int(hold) for hold in holds)
    assert 7.0 in holds  # 10 s of hovering less 2.2 s of settling, rounded down
    assert mission.duration_s == pytest.approx(35.0)
