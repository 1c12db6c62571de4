from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymap3d import enu2geodetic

from skyfolio.mavlink_bridge import (
    Command,
    Frame,
    Mission,
    MissionItem,
    OnEnd,
    TooManyItems,
    UnknownUav,
    compile_mission,
    geodetic_to_east_north,
)
from skyfolio.planner import geodesy
from skyfolio.planner.plans import Plan

coordinate = st.one_of(st.sampled_from([0.0, 10.0, 25.0]), st.floats(-300, 300))
paths = st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=40)
PlanOf = Callable[..., Plan]


def alternating(slots: int) -> list[tuple[float, float]]:
    """A straight line whose legs are 10 and 12 m long in turn: every leg has another speed than the last."""
    return [(11.0 * slot + slot % 2, 0.0) for slot in range(slots)]


def commands(mission: Mission) -> list[int]:
    return [item.command for item in mission.items]


def speed_at(mission: Mission, seq: int) -> float | None:
    """Ground speed commanded when the vehicle flies to item `seq`."""
    speeds = [item.param2 for item in mission.items[:seq] if item.command == Command.DO_CHANGE_SPEED]
    return speeds[-1] if speeds else None


@given(path=paths, airborne=st.booleans(), on_end=st.sampled_from(OnEnd))
def test_every_mission_is_gapless_with_one_current_item_and_a_speed_before_each_leg(
    plan_of: PlanOf, path: list[tuple[float, float]], airborne: bool, on_end: OnEnd
) -> None:
    mission = compile_mission(plan_of({"uav-1": path}), "uav-1", airborne=airborne, on_end=on_end)
    assert [item.seq for item in mission.items] == list(range(len(mission.items)))
    assert [item.seq for item in mission.items if item.current] == [0]
    waypoints = [item.seq for item in mission.items if item.command == Command.NAV_WAYPOINT]
    assert waypoints == list(mission.slot_of_item)
    first = 0 if airborne and len(path) > 1 else 1
    assert all(speed_at(mission, seq) is not None for seq in waypoints[first:])
    speeds = [item.param2 for item in mission.items if item.command == Command.DO_CHANGE_SPEED]
    assert all(a != b for a, b in pairwise(speeds))
    assert all(speed > 0 for speed in speeds)
    assert mission.duration_s == pytest.approx(len(path) * 5.0)


@given(path=paths)
def test_every_waypoint_lies_where_its_slot_begins(plan_of: PlanOf, path: list[tuple[float, float]]) -> None:
    plan = plan_of({"uav-1": path})
    mission = compile_mission(plan, "uav-1")
    for seq, slot in mission.slot_of_item.items():
        item = mission.items[seq]
        point = geodetic_to_east_north(plan.scenario.origin, item.x / 1e7, item.y / 1e7)
        assert point == pytest.approx(path[slot], abs=0.02)
        assert item.z == plan.scenario.altitude_m
        assert item.frame == Frame.GLOBAL_RELATIVE_ALT_INT


def test_twenty_moving_slots_take_41_items(plan_of: PlanOf) -> None:
    path = alternating(20)
    mission = compile_mission(plan_of({"uav-1": path}), "uav-1")
    assert len(mission.items) == 1 + 1 + 2 * 19 + 1
    assert commands(mission)[:4] == [
        Command.NAV_TAKEOFF,
        Command.NAV_WAYPOINT,
        Command.DO_CHANGE_SPEED,
        Command.NAV_WAYPOINT,
    ]


def test_line_and_hover_compiles_to_the_items_worked_by_hand(line_and_hover: Plan) -> None:
    mission = compile_mission(line_and_hover, "uav-1")
    assert commands(mission) == [22, 16, 178, 16, 178, 16, 178, 16, 178, 16, 21]
    assert dict(mission.slot_of_item) == {1: 0, 3: 1, 5: 2, 7: 5, 9: 6}
    assert [mission.items[seq].param1 for seq in mission.slot_of_item] == [0.0, 0.0, 10.0, 0.0, 5.0]
    assert mission.duration_s == 35.0
    assert mission.items[-1].z == 0.0
    assert (mission.items[-1].x, mission.items[-1].y) == (mission.items[9].x, mission.items[9].y)
    assert [mission.item_of_slot(slot) for slot in range(7)] == [1, 3, 5, 5, 5, 7, 9]


def test_in_flight_it_neither_takes_off_nor_flies_back_to_slot_0(line_and_hover: Plan) -> None:
    mission = compile_mission(line_and_hover, "uav-1", airborne=True, first_leg_s=2.5)
    assert commands(mission) == [178, 16, 178, 16, 178, 16, 178, 16, 21]
    assert dict(mission.slot_of_item) == {1: 1, 3: 2, 5: 5, 7: 6}
    assert mission.items[0].current == 1
    assert mission.items[0].param2 >= 20 / 2.5
    assert mission.duration_s == pytest.approx(2.5 + 6 * 5.0)


def test_slots_that_continue_straight_at_one_speed_become_one_leg(plan_of: PlanOf) -> None:
    path = [(10.0 * slot, 0.0) for slot in range(8)]
    mission = compile_mission(plan_of({"uav-1": path}), "uav-1")
    assert dict(mission.slot_of_item) == {1: 0, 3: 1, 5: 6, 7: 7}  # from rest, straight through, to rest
    assert commands(mission).count(Command.DO_CHANGE_SPEED) == 3
    assert mission.duration_s == 40.0


def test_a_bend_of_half_a_metre_is_flown(plan_of: PlanOf) -> None:
    path = [(10.0 * slot, 0.5 if slot == 4 else 0.0) for slot in range(8)]
    mission = compile_mission(plan_of({"uav-1": path}), "uav-1")
    assert {3, 4, 5} <= set(mission.slot_of_item.values())


@pytest.mark.parametrize("airborne", [False, True])
def test_all_slots_hovering_is_a_valid_mission(plan_of: PlanOf, airborne: bool) -> None:
    mission = compile_mission(plan_of({"uav-1": [(3.0, 4.0)] * 20}), "uav-1", airborne=airborne)
    assert commands(mission) == ([178, 16, 21] if airborne else [22, 16, 21])
    assert sum(item.param1 for item in mission.items if item.command == 16) == pytest.approx(100)


@pytest.mark.parametrize("airborne", [False, True])
def test_a_single_slot_is_a_valid_mission(plan_of: PlanOf, airborne: bool) -> None:
    mission = compile_mission(plan_of({"uav-1": [(3.0, 4.0)]}), "uav-1", airborne=airborne)
    assert commands(mission) == ([16, 21] if airborne else [22, 16, 21])
    assert dict(mission.slot_of_item) == {len(mission.items) - 2: 0}


@pytest.mark.parametrize(
    ("on_end", "command", "frame"),
    [
        (OnEnd.LAND, Command.NAV_LAND, Frame.GLOBAL_RELATIVE_ALT_INT),
        (OnEnd.RETURN, Command.NAV_RETURN_TO_LAUNCH, Frame.MISSION),
        (OnEnd.HOLD, Command.NAV_LOITER_UNLIM, Frame.GLOBAL_RELATIVE_ALT_INT),
    ],
)
def test_the_mission_ends_as_asked(line_and_hover: Plan, on_end: OnEnd, command: Command, frame: Frame) -> None:
    last = compile_mission(line_and_hover, "uav-1", on_end=on_end).items[-1]
    assert (last.command, last.frame) == (command, frame)


def test_too_long_a_plan_is_refused_by_name_and_number(plan_of: PlanOf) -> None:
    path = alternating(100)
    with pytest.raises(TooManyItems, match=r"'uav-1' needs 201 items, more than the 200"):
        compile_mission(plan_of({"uav-1": path}), "uav-1")


def test_an_unknown_uav_is_refused_with_the_names_that_are_known(line_and_hover: Plan) -> None:
    with pytest.raises(UnknownUav, match=r"'uav-9' is not in the plan; it flies uav-1"):
        compile_mission(line_and_hover, "uav-9")


@pytest.mark.parametrize("first_leg_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_first_leg_without_time_is_refused(line_and_hover: Plan, first_leg_s: float) -> None:
    with pytest.raises(ValueError, match="first_leg_s"):
        compile_mission(line_and_hover, "uav-1", airborne=True, first_leg_s=first_leg_s)


def test_a_first_leg_time_on_the_ground_is_a_misuse(line_and_hover: Plan) -> None:
    with pytest.raises(ValueError, match="airborne"):
        compile_mission(line_and_hover, "uav-1", first_leg_s=3.0)


def test_a_mission_with_gaps_or_without_a_current_item_cannot_be_made() -> None:
    item = MissionItem(seq=0, frame=6, command=16, current=1)
    with pytest.raises(ValueError, match="seq"):
        Mission(uav_id="u", items=(MissionItem(seq=1, frame=6, command=16, current=1),), slot_of_item={}, duration_s=1)
    with pytest.raises(ValueError, match="seq"):
        Mission(uav_id="u", items=(), slot_of_item={}, duration_s=1)
    with pytest.raises(ValueError, match="current"):
        Mission(
            uav_id="u",
            items=(item, MissionItem(seq=1, frame=6, command=16, current=1)),
            slot_of_item={},
            duration_s=1,
        )


def test_a_long_mission_asks_for_its_places_as_often_as_a_short_one(
    plan_of: PlanOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def counted(*args: Any) -> Any:
        asked.append(np.size(args[0]))
        return enu2geodetic(*args)

    monkeypatch.setattr(geodesy, "enu2geodetic", counted)
    calls = []
    for slots in (4, 40):
        asked.clear()
        compile_mission(plan_of({"uav-1": alternating(slots)}), "uav-1")
        assert set(asked) == {slots}
        calls.append(len(asked))
    assert calls[0] == calls[1]
