"""Missions and setpoints over terrain: above mean sea level, alike for every home, and never beneath the plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from skyfolio.mavlink_bridge import Autopilot, Command, Frame, Mission, OnEnd, compile_mission, to_qgc_plan
from skyfolio.mavlink_bridge.altitudes import Altitudes, altitudes_of, lowest_over_ground_m, over_ground
from skyfolio.mavlink_bridge.compare import mission_differences
from skyfolio.mavlink_bridge.corridors import Corridor, meetings
from skyfolio.mavlink_bridge.e7 import to_e7
from skyfolio.mavlink_bridge.findings import Level, OverGround
from skyfolio.mavlink_bridge.preflight import audit
from skyfolio.mavlink_bridge.stream import LEAD_S, Streamer
from skyfolio.planner.plans import Plan
from skyfolio.planner.terrain import Terrain
from tests.mavlink_bridge.test_preflight import NEEDS, facts

PlanOf = Callable[..., Plan]
PATH = [(0.0, 0.0), (20.0, 0.0), (40.0, 0.0), (40.0, 0.0), (40.0, 0.0), (40.0, 20.0)]
UP = [500.001, 505.0, 510.0, 510.0, 516.0, 513.0]


def ramp() -> Terrain:
    """400 m in the west, rising by 1 m a metre to the east."""
    return Terrain(south_west_m=(-100.0, -100.0), spacing_m=300.0, heights_m=((300.0, 600.0), (300.0, 600.0)))


@pytest.fixture
def hilly(plan_of: PlanOf) -> Plan:
    plan = plan_of({"uav-1": PATH})
    scenario = plan.scenario.model_copy(update={"terrain": ramp(), "clearance_m": 20.0})
    return plan.model_copy(update={"scenario": scenario, "altitudes_m": {"uav-1": UP}})


def heights(mission: Mission, command: Command) -> list[float]:
    return [item.z for item in mission.items if item.command == command]


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_every_waypoint_is_above_sea_level_where_and_as_high_as_its_slot_begins(
    hilly: Plan, autopilot: Autopilot
) -> None:
    mission = compile_mission(hilly, "uav-1", autopilot=autopilot)
    for seq, slot in mission.slot_of_item.items():
        item = mission.items[seq]
        assert item.frame == Frame.GLOBAL
        assert UP[slot] <= item.z <= UP[slot] + 0.0101
    assert heights(mission, Command.NAV_TAKEOFF) == [500.01]
    assert heights(mission, Command.NAV_LAND) == [pytest.approx(440.0)]  # the ground there, not home
    assert not [item for item in mission.items if item.frame == Frame.GLOBAL_RELATIVE_ALT_INT]


def test_a_hover_and_a_climb_at_one_place_are_two_stops_that_take_as_long_as_their_slots(hilly: Plan) -> None:
    mission = compile_mission(hilly, "uav-1")
    assert sorted(mission.slot_of_item.values()) == [0, 1, 2, 4, 5]
    assert mission.duration_s == pytest.approx(30.0)
    assert heights(mission, Command.NAV_WAYPOINT) == [500.01, 505.0, 510.0, 516.0, 513.0]


def test_slots_that_continue_straight_on_are_one_leg_only_on_one_level(hilly: Plan) -> None:
    line = [(20.0 * n, 0.0) for n in range(6)]
    climbing = hilly.model_copy(
        update={"trajectories_m": {"uav-1": line}, "altitudes_m": {"uav-1": [500.0 + 2.0 * n for n in range(6)]}}
    )
    level = climbing.model_copy(update={"altitudes_m": {"uav-1": [500.0] * 6}})
    assert len(compile_mission(climbing, "uav-1").slot_of_item) == 6
    assert len(compile_mission(level, "uav-1").slot_of_item) < 6


def test_a_mission_in_flight_hovers_at_its_own_height_and_holds_there(hilly: Plan) -> None:
    begun = altitudes_of(hilly, "uav-1").begun_at(503.3)
    mission = compile_mission(hilly, "uav-1", airborne=True, first_leg_s=4.0, on_end=OnEnd.HOLD, altitudes=begun)
    assert heights(mission, Command.NAV_LOITER_UNLIM) == [513.0]
    assert heights(mission, Command.NAV_WAYPOINT)[0] == 505.0


def test_without_terrain_altitudes_that_were_chosen_count_from_home(hilly: Plan) -> None:
    plain = hilly.scenario.model_copy(update={"terrain": None, "clearance_m": None})
    chosen = hilly.model_copy(update={"scenario": plain, "altitudes_m": {"uav-1": [up - 450.0 for up in UP]}})
    mission = compile_mission(chosen, "uav-1")
    assert {item.frame for item in mission.items if item.has_position} == {Frame.GLOBAL_RELATIVE_ALT_INT}
    assert heights(mission, Command.NAV_LAND) == [0.0]
    assert heights(mission, Command.NAV_WAYPOINT)[1] == pytest.approx(55.0)


def test_a_read_back_above_home_instead_of_above_sea_level_is_a_difference(hilly: Plan) -> None:
    mission = compile_mission(hilly, "uav-1")
    stored = [replace(item, frame=5) if item.has_position else item for item in mission.items]  # as PX4 sends it
    assert mission_differences(mission.items, stored, autopilot=Autopilot.PX4) == ()
    wrong = [replace(item, frame=6) if item.has_position else item for item in mission.items]
    assert mission_differences(mission.items, wrong, autopilot=Autopilot.PX4)


def test_a_file_for_qgroundcontrol_says_that_altitudes_are_absolute(hilly: Plan) -> None:
    document = to_qgc_plan(compile_mission(hilly, "uav-1"))["mission"]
    assert document["globalPlanAltitudeMode"] == 2
    assert {item["AltitudeMode"] for item in document["items"] if "AltitudeMode" in item} == {2}


def test_a_stream_climbs_with_the_plan_above_sea_level(hilly: Plan) -> None:
    streamer = Streamer(1, PATH, 5.0, altitudes_of(hilly, "uav-1"), lambda point: (47.0 + point[1] / 1e5, 8.0))
    halfway = streamer.setpoint(7.5 - LEAD_S).fields
    assert halfway["coordinate_frame"] == 5
    assert halfway["alt"] == pytest.approx(507.5, abs=0.01)
    assert halfway["vz"] == pytest.approx(-1.0)  # down: it climbs 5 m in 5 s
    assert halfway["lat_int"] == to_e7(47.0)
    waiting, over = streamer.setpoint(-3.0).fields, streamer.setpoint(99.0).fields
    assert (waiting["alt"], waiting["vz"], over["alt"], over["vz"]) == (500.01, 0.0, 513.0, 0.0)


def test_altitudes_between_slots_are_on_straight_lines() -> None:
    climbs = Altitudes((10.0, 20.0, 15.0))
    assert [climbs.at(at) for at in (-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 9.0)] == [10.0, 10.0, 15.0, 20.0, 17.5, 15.0, 15.0]
    assert [climbs.climb_m(at) for at in (-0.5, 0.0, 1.9, 2.0)] == [0.0, 10.0, -5.0, 0.0]
    assert Altitudes((7.0,)).at(3.0) == 7.0


def test_two_routes_one_above_the_other_need_room_between_the_top_of_one_and_the_bottom_of_the_other() -> None:
    def route(name: str, height_m: float, top_m: float | None) -> Corridor:
        line = [(0.0, 0.0), (100.0, 0.0)]
        return Corridor(uav_id=name, owner="us", required_m=5.0, level_m=line, height_m=height_m, top_m=top_m)

    climbing = route("a", 400.0, 440.0)
    assert meetings([climbing], [route("b", 430.0, 460.0)])
    assert meetings([route("b", 444.0, None)], [climbing])
    assert not meetings([climbing], [route("b", 445.0, None)])
    assert not meetings([route("b", 380.0, 395.0)], [climbing])


def test_what_a_plan_needs_of_a_home_is_measured_over_the_ground(hilly: Plan) -> None:
    needs = over_ground(hilly, "uav-1", (0.0, 0.0))
    assert needs is not None
    assert needs.home_ground_m == pytest.approx(400.0)
    assert needs.way_home_m == pytest.approx(505.0 - 440.0 - 5.0 + 5.0, abs=10.1)
    far = over_ground(hilly, "uav-1", (120.0, 0.0))
    assert far is not None
    assert far.way_home_m < 0.0  # up the ramp, the ground is at 520 m
    assert lowest_over_ground_m(hilly.scenario, [(0.0, 0.0), (50.0, 0.0)], 500.0) == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("home_amsl_m", "way_home_m", "named"),
    [
        (409.0, 40.0, None),
        (None, 40.0, None),
        (411.0, 40.0, "home altitude"),
        (389.0, 40.0, "home altitude"),
        (400.0, 18.5, None),
        (400.0, 17.5, "way home"),
    ],
)
def test_the_audit_refuses_a_home_that_contradicts_the_terrain(
    home_amsl_m: float | None, way_home_m: float, named: str | None
) -> None:
    needs = replace(NEEDS, ground=OverGround(home_ground_m=400.0, clearance_m=20.0, way_home_m=way_home_m))
    found = audit(facts(Autopilot.PX4, home_amsl_m=home_amsl_m), needs)
    assert [finding.name for finding in found] == ([named] if named else [])
    assert all(finding.level is Level.BLOCKER and finding.refuses for finding in found)


def test_the_audit_says_how_much_too_low_it_would_fly() -> None:
    needs = replace(NEEDS, ground=OverGround(home_ground_m=400.0, clearance_m=20.0, way_home_m=40.0))
    [found] = audit(facts(Autopilot.PX4, home_amsl_m=415.0), needs)
    assert found.found == "415.0 m above sea level"
    assert found.why == "it would fly 15 m too low over the ground"
