"""The schedule keeper by itself: what it orders in situations worked by hand."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from skyfolio.mavlink_bridge import Autopilot, OnEnd, compile_mission
from skyfolio.mavlink_bridge.ardupilot import ARDUCOPTER_MODEL as ARDUCOPTER
from skyfolio.mavlink_bridge.keeper import Keeper, Order
from skyfolio.mavlink_bridge.px4 import PX4_MODEL as PX4
from skyfolio.planner.plans import Plan

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


@pytest.mark.parametrize(
    ("north_m", "pace_mps", "late_s", "off"),
    [
        (0.0, 0.0, None, False),
        (4.9, 0.0, None, False),
        (5.1, 0.0, None, True),
        (3.0, 0.05, None, False),  # a minute, if seconds counted
        (3.0, 0.9, None, False),
        (3.0, 1.0, 3.0, True),
        (1.9, 1.0, 1.9, False),
        (1.9, 0.5, None, False),
        (8.0, 5.0, 1.6, False),
        (10.5, 5.0, 2.1, True),
    ],
)
def test_one_that_hovers_or_creeps_is_off_by_metres_and_seconds_are_for_one_that_moves(
    plan_of: PlanOf, north_m: float, pace_mps: float, late_s: float | None, off: bool
) -> None:
    path = [(0.0, 0.0), (0.0, 5.0 * pace_mps)]
    mission = compile_mission(plan_of({"uav-1": path}), "uav-1", on_end=OnEnd.HOLD)
    slip = Keeper(path, 5.0, mission, PX4).slip(5.0, (0.0, 5.0 * pace_mps - north_m))
    assert slip is not None
    assert slip.distance_m == pytest.approx(north_m)
    assert slip.late_s == (None if late_s is None else pytest.approx(late_s))
    assert slip.off_schedule is off


def test_arducopters_whole_second_holds_leave_the_rest_to_the_next_leg(plan_of: PlanOf) -> None:
    mission = compile_mission(
        plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD, autopilot=Autopilot.ARDUPILOT, model=ARDUCOPTER
    )
    holds = [mission.items[seq].param1 for seq in mission.slot_of_item]
    assert all(hold == int(hold) for hold in holds)
    assert 7.0 in holds  # 10 s of hovering less 2.2 s of settling, rounded down
    assert mission.duration_s == pytest.approx(35.0)


def flown_at(keeper: Keeper, point: tuple[float, float], item: int, *, until_s: float, from_s: float) -> list[Order]:
    """What is ordered to one that stays at a point, looked at ten times a second."""
    times = [from_s + 0.1 * n for n in range(round((until_s - from_s) * 10))]
    return [order for at in times if (order := keeper.advise(at, point, (0.0, 0.0), item)) is not None]


@pytest.mark.parametrize("short_m", [0.8, 2.0, 12.0], ids=["at its waypoint", "beside it", "on its way"])
def test_one_that_stays_at_a_waypoint_although_it_is_overdue_is_told_to_go_on_and_that_is_said(
    keeper: Keeper, plan_of: PlanOf, short_m: float
) -> None:
    at = item_at(plan_of, 5)
    here = (20.0 - short_m, 40.0)
    orders = flown_at(keeper, here, at, from_s=25.1, until_s=28.9)
    assert all(order.stuck is None for order in orders)  # 4 s of patience
    (order,) = [one for one in flown_at(keeper, here, at, from_s=28.9, until_s=29.9) if one.item is not None]
    assert order.item == at + 1
    assert order.stuck is not None
    assert (order.stuck.item, order.stuck.distance_m) == (at, short_m)
    assert order.stuck.for_s == pytest.approx(4.0, abs=0.6)


def test_one_that_is_late_but_comes_nearer_is_not_stuck(keeper: Keeper, plan_of: PlanOf) -> None:
    at = item_at(plan_of, 2)
    orders = [keeper.advise(20.1 + n / 2, (0.0, 20.0 + n), (0.0, 2.0), at) for n in range(18)]
    assert all(order is None or order.item is None for order in orders)


def test_one_that_waits_out_a_hold_is_not_stuck(keeper: Keeper, plan_of: PlanOf) -> None:
    assert all(o.item is None for o in flown_at(keeper, (0.0, 40.0), item_at(plan_of, 2), from_s=10.0, until_s=19.5))


def test_after_the_last_slot_it_gets_its_own_speed_back_once_and_only_if_another_was_ordered(
    keeper: Keeper, plan_of: PlanOf
) -> None:
    assert keeper.advise(5.5, (0.0, 14.0), (0.0, 4.0), item_at(plan_of, 2)) is not None
    last = keeper.advise(30.0, (40.0, 40.0), (0.0, 0.0), item_at(plan_of, 6))
    assert last is not None
    assert (last.speed_mps, last.its_own_speed) == (PX4.cruise_mps, True)
    assert keeper.advise(31.0, (40.0, 40.0), (0.0, 0.0), item_at(plan_of, 6)) is None


def test_a_speed_that_was_not_taken_is_ordered_again(plan_of: PlanOf) -> None:
    straight = [(0.0, 20.0 * n) for n in range(5)]
    mission = compile_mission(plan_of({"uav-1": straight}), "uav-1", on_end=OnEnd.HOLD)
    keeper, at = Keeper(straight, 5.0, mission, PX4), max(mission.slot_of_item)
    order = keeper.advise(5.5, (0.0, 22.0), (0.0, 4.0), at)
    assert order is not None
    assert keeper.advise(6.0, (0.0, 24.0), (0.0, 4.0), at) is None  # as ordered
    keeper.not_taken(order)
    again = keeper.advise(6.0, (0.0, 24.0), (0.0, 4.0), at)
    assert again is not None
    assert again.speed_mps == pytest.approx(4.0, abs=0.3)


def test_a_hold_before_a_leg_that_begins_slowly_is_left_early(plan_of: PlanOf) -> None:
    path = [(0.0, 0.0)] * 4 + [(0.0, 25.0), (25.0, 25.0)]
    for model, autopilot, ahead_s in ((ARDUCOPTER, Autopilot.ARDUPILOT, 1.82), (PX4, Autopilot.PX4, 0.58)):
        mission = compile_mission(
            plan_of({"uav-1": path}), "uav-1", on_end=OnEnd.HOLD, autopilot=autopilot, model=model
        )
        hold = min(mission.slot_of_item)
        keeper = Keeper(path, 5.0, mission, model)
        times = [12.0 + 0.1 * n for n in range(40)]
        left = next((at for at in times if keeper.advise(at, (0.0, 0.0), (0.0, 0.0), hold) is not None), None)
        assert left == pytest.approx(15.0 - 0.2 - ahead_s, abs=0.11)


def test_an_arducopter_that_came_early_while_nobody_kept_it_holds_until_its_time(plan_of: PlanOf) -> None:
    mission = compile_mission(
        plan_of({"uav-1": PATH}), "uav-1", on_end=OnEnd.HOLD, autopilot=Autopilot.ARDUPILOT, model=ARDUCOPTER
    )
    seq = next(seq for seq, first in mission.slot_of_item.items() if first == 2)
    assert mission.items[seq].param1 > 0
    kept = Keeper(PATH, 5.0, mission, ARDUCOPTER, since_s=8.0)  # after a restart: since when it holds, nobody knows
    held = [now for now in (8.0 + 0.5 * n for n in range(30)) if (order := kept.advise(now, PATH[2], (0.0, 0.0), seq))
            and order.item == seq]  # fmt: skip
    assert held[0] == 8.0
    hold_s = mission.items[seq].param1
    assert all(later - sooner <= hold_s for sooner, later in pairwise(held))
    leaves_s = 20.0
    assert leaves_s - hold_s - 2.0 <= held[-1] < leaves_s
    on_time = Keeper(PATH, 5.0, mission, ARDUCOPTER)
    assert on_time.advise(10.0, PATH[2], (0.0, 0.0), seq) is None


def test_a_last_hold_that_was_begun_anew_ends_with_the_plan(plan_of: PlanOf) -> None:
    path = [(0.0, 0.0), (0.0, 25.0), *[(0.0, 50.0)] * 6]
    mission = compile_mission(
        plan_of({"uav-1": path}), "uav-1", on_end=OnEnd.LAND, autopilot=Autopilot.ARDUPILOT, model=ARDUCOPTER
    )
    hold = max(mission.slot_of_item)
    keeper = Keeper(path, 5.0, mission, ARDUCOPTER, since_s=12.0)
    orders = {at / 2: keeper.advise(at / 2, (0.0, 50.0), (0.0, 0.0), hold) for at in range(24, 110)}
    asked = [(at, order.item) for at, order in orders.items() if order is not None and order.item is not None]
    assert hold in [item for _, item in asked[:-1]]
    assert asked[-1] == (40.0, hold + 1)  # said once, when the last slot is over
    told = orders[40.0]
    assert told is not None
    keeper.not_taken(told)
    assert keeper.advise(56.0, (0.0, 50.0), (0.0, 0.0), hold) is not None  # once more
    assert keeper.advise(57.0, (0.0, 50.0), (0.0, 0.0), hold) is None
