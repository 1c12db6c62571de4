"""sim.mission_runner, flown by an autopilot in virtual time"""

import math
from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim.modes import Mode

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, Items

MISSION, HOLD = 4, 3


def distance(bench: "Bench", north_m: float, east_m: float) -> float:
    return bench.autopilot.body.distance_to(east_m, north_m)


def test_a_whole_mission_from_the_ground_to_the_ground(bench: "Bench", items: "Items") -> None:
    bench.upload(
        items.add(22, current=1.0, up_m=30.0),
        items.waypoint(0.0, 0.0, 30.0),
        items.speed(4.0),
        items.waypoint(40.0, 0.0, 30.0),
        items.waypoint(40.0, 30.0, 30.0, p1=5.0),
        items.add(21, x=0.0, y=0.0, up_m=0.0),
    )
    bench.command(400, 1.0)
    assert bench.set_mode(MISSION) == 0
    bench.fly_until(lambda: not bench.autopilot.armed)
    assert bench.reached() == [0, 1, 2, 3, 4, 5]
    assert distance(bench, 40.0, 30.0) < 2.5
    assert bench.kinds()[-3:] == ["landed", "item_reached", "disarmed"]
    assert bench.autopilot.mode is Mode.MISSION
    assert bench.autopilot.runner.complete


def test_a_speed_change_sets_the_speed_of_the_next_leg(airborne: "Bench", items: "Items") -> None:
    airborne.upload(
        items.speed(7.0, current=1.0), items.waypoint(200.0, 0.0), items.speed(3.0), items.waypoint(300.0, 0.0)
    )
    airborne.set_mode(MISSION)
    airborne.fly(10.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(7.0, abs=0.05)
    airborne.fly_until(lambda: 1 in airborne.reached())
    airborne.fly(3.0)
    assert airborne.autopilot.body.ground_speed_mps == pytest.approx(3.0, abs=0.05)


def test_a_straight_waypoint_is_flown_through_without_slowing(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.speed(5.0, current=1.0), items.waypoint(40.0, 0.0), items.waypoint(120.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly(5.0)
    slowest = 5.0
    while airborne.autopilot.body.north_m < 80.0:
        airborne.fly(0.05)
        slowest = min(slowest, airborne.autopilot.body.ground_speed_mps)
    assert slowest > 4.9


@pytest.mark.parametrize(("north", "east", "low", "high"), [(0.0, 60.0, 2.0, 3.5), (-60.0, 0.0, 0.0, 1.0)])
def test_the_sharper_the_corner_the_slower_it_is_flown(
    airborne: "Bench", items: "Items", north: float, east: float, low: float, high: float
) -> None:
    airborne.upload(items.speed(8.0, current=1.0), items.waypoint(60.0, 0.0), items.waypoint(60.0 + north, east))
    airborne.set_mode(MISSION)
    airborne.fly(5.0)
    slowest = 8.0
    while airborne.autopilot.runner.index < 2 or airborne.autopilot.body.ground_speed_mps < slowest + 0.5:
        airborne.fly(0.05)
        slowest = min(slowest, airborne.autopilot.body.ground_speed_mps)
    assert low <= slowest <= high


def test_a_hold_starts_when_the_waypoint_is_reached_and_lasts_for_its_param1(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(30.0, 0.0, current=1.0, p1=6.0), items.waypoint(60.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: distance(airborne, 30.0, 0.0) <= 2.0)
    assert airborne.fly_until(lambda: airborne.reached() == [0]) == pytest.approx(6.0, abs=0.2)
    assert distance(airborne, 30.0, 0.0) < 0.1


def test_the_acceptance_radius_of_an_item_counts_before_the_parameter(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(50.0, 0.0, current=1.0, p2=10.0), items.waypoint(100.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.reached() == [0])
    assert 9.0 < distance(airborne, 50.0, 0.0) <= 10.0


def test_at_the_end_of_a_mission_it_holds(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(20.0, 0.0, current=1.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.autopilot.mode is Mode.HOLD)
    airborne.fly(10.0)
    assert distance(airborne, 20.0, 0.0) < 3.0
    assert airborne.autopilot.body.up_m == pytest.approx(20.0, abs=0.1)


def test_an_unlimited_loiter_never_ends_the_mission(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(20.0, 0.0, current=1.0), items.add(17, north_m=40.0))
    airborne.set_mode(MISSION)
    airborne.fly(120.0)
    assert airborne.autopilot.mode is Mode.MISSION
    assert airborne.reached() == [0]
    assert distance(airborne, 40.0, 0.0) < 0.1


def test_the_return_item_brings_it_home_and_down(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(50.0, 50.0, current=1.0), items.add(20, frame=2.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    assert distance(airborne, 0.0, 0.0) < 0.1
    assert "RTL" in [detail.get("mode") for _, _, detail in airborne.events]


def test_a_new_mission_in_flight_is_flown_at_once_from_its_current_item(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.speed(5.0, current=1.0), items.waypoint(300.0, 0.0), items.waypoint(400.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly(10.0)
    items.seq = 0
    airborne.upload(items.waypoint(0.0, -50.0), items.speed(6.0, current=1.0), items.waypoint(50.0, 80.0))
    assert airborne.autopilot.mode is Mode.MISSION
    lowest, slowest = math.inf, math.inf
    while distance(airborne, 50.0, 80.0) > 3.0:
        airborne.fly(0.05)
        lowest = min(lowest, airborne.autopilot.body.up_m)
        slowest = min(slowest, airborne.autopilot.body.ground_speed_mps)
    assert lowest > 19.8
    assert slowest > 2.0
    assert airborne.reached()[1:2] == [1]


def test_a_shorter_mission_without_a_current_item_clamps_the_old_index(airborne: "Bench", items: "Items") -> None:
    airborne.upload(*[items.waypoint(10.0 * n, 0.0, current=float(n == 1)) for n in range(1, 8)])
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.autopilot.runner.index == 5)
    items.seq = 0
    airborne.upload(items.waypoint(0.0, 30.0), items.waypoint(0.0, 60.0))
    assert airborne.autopilot.runner.index == 1
    airborne.fly_until(lambda: airborne.autopilot.mode is Mode.HOLD)
    assert distance(airborne, 0.0, 60.0) < 3.0


def test_a_paused_mission_goes_on_where_it_stopped(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(30.0, 0.0, current=1.0), items.waypoint(90.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.reached() == [0])
    airborne.set_mode(HOLD)
    airborne.fly(20.0)
    assert airborne.autopilot.body.ground_speed_mps < 0.05
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.autopilot.mode is Mode.HOLD)
    assert airborne.reached() == [0, 1]


def test_a_mission_that_starts_with_a_waypoint_climbs_before_it_goes(bench: "Bench", items: "Items") -> None:
    bench.upload(items.waypoint(50.0, 0.0, 15.0, current=1.0))
    bench.command(400, 1.0)
    bench.set_mode(MISSION)
    bench.fly_until(lambda: bench.autopilot.body.north_m > 1.0)
    assert bench.autopilot.body.up_m > 14.0


def test_a_waypoint_is_not_reached_before_its_altitude(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(5.0, 0.0, 50.0, current=1.0), items.waypoint(50.0, 0.0, 50.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.reached() == [0])
    assert airborne.autopilot.body.up_m > 49.0
    assert distance(airborne, 5.0, 0.0) <= 2.0


def climbing(items: "Items", legs: int = 6) -> list[Any]:
    """Legs of 25 m in 5 s that climb 6.9 m each, as recorded over a hill."""
    begin = items.speed(5.0, current=1.0)
    ways = [items.waypoint(25.0 * leg, 0.0, 20.0 + 6.9 * leg, p2=1.0) for leg in range(1, legs + 1)]
    return [begin, *ways, items.waypoint(25.0 * (legs + 1), 0.0, 20.0 + 6.9 * legs)]


def seconds_over(bench: "Bench", mission: list[Any]) -> float:
    """How long it flies over all legs but the last."""
    bench.upload(*mission)
    bench.set_mode(MISSION)
    return bench.fly_until(lambda: len(mission) - 2 in bench.reached())


def test_a_px4_as_delivered_misses_its_waypoints_on_a_climb(airborne: "Bench", items: "Items") -> None:
    """Six such legs took a real one 62 s instead of 30: it was 104 m behind."""
    assert seconds_over(airborne, climbing(items)) > 45.0


def test_a_px4_that_takes_waypoints_at_other_altitudes_keeps_its_schedule_on_a_climb(
    airborne: "Bench", items: "Items"
) -> None:
    """With 10 m a real one was never more than 2.6 m behind."""
    airborne.autopilot.parameters["NAV_MC_ALT_RAD"] = 10.0
    highest_m, mission, began_s = 0.0, climbing(items), airborne.autopilot.now_s
    airborne.upload(*mission)
    airborne.set_mode(MISSION)
    while len(mission) - 2 not in airborne.reached():
        airborne.fly(0.05)
        leg = min(max(airborne.autopilot.runner.index, 1), 6)
        highest_m = max(highest_m, airborne.autopilot.body.up_m - (20.0 + 6.9 * leg))
    assert airborne.autopilot.now_s - began_s < 33.0
    assert 1.5 < highest_m < 3.5  # it passes altitudes by some 2.5 m


def test_a_mission_that_is_entered_too_low_begins_with_a_climb_on_the_spot(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(50.0, 0.0, 25.0, current=1.0), items.waypoint(100.0, 0.0, 25.0))
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.autopilot.body.north_m > 1.0)
    assert airborne.autopilot.body.up_m > 24.0
    airborne.set_mode(HOLD)
    airborne.fly_until(lambda: airborne.autopilot.body.ground_speed_mps < 0.1)
    airborne.set_mode(MISSION)
    assert airborne.fly_until(lambda: airborne.autopilot.body.ground_speed_mps > 1.0) < 2.0  # high enough by now


def test_left_on_the_ground_it_disarms_after_ten_seconds(bench: "Bench") -> None:
    bench.command(400, 1.0)
    bench.fly(9.8)
    assert bench.autopilot.armed
    bench.fly(0.4)
    assert bench.kinds()[-1] == "disarmed"
    assert any(getattr(message, "text", "").startswith("Disarmed by auto preflight") for message in bench.sent)


def test_a_waypoint_turns_the_nose_to_its_yaw_and_no_faster_than_the_limit(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.waypoint(200.0, 0.0, current=1.0), items.waypoint(400.0, 0.0))
    airborne.set_mode(MISSION)
    airborne.fly(5.0)
    assert airborne.autopilot.body.yaw_rad == pytest.approx(0.0, abs=0.01)
    items.seq = 0
    turned = list(items.waypoint(400.0, 0.0, current=1.0))
    turned[8] = 90.0
    airborne.upload(tuple(turned))
    airborne.fly(0.5)
    assert airborne.autopilot.body.yaw_rad == pytest.approx(math.radians(30.0), abs=0.06)
    airborne.fly(2.0)
    assert airborne.autopilot.body.yaw_rad == pytest.approx(math.pi / 2.0, abs=0.01)


def test_loiter_time_and_delay_stay_as_long_as_they_say(airborne: "Bench", items: "Items") -> None:
    airborne.upload(
        items.add(19, current=1.0, north_m=20.0, p1=6.0),
        items.add(93, frame=2.0, p1=4.0, x=0.0, y=0.0, up_m=0.0),
        items.waypoint(40.0, 0.0),
    )
    airborne.set_mode(MISSION)
    airborne.fly_until(lambda: airborne.reached() == [0])
    loitered = airborne.autopilot.now_s
    assert distance(airborne, 20.0, 0.0) < 0.5
    waited = airborne.fly_until(lambda: airborne.reached() == [0, 1])
    assert waited == pytest.approx(4.0, abs=0.1)
    near = [t for t, kind, _ in airborne.events if kind == "mode"][-1]
    assert loitered - near > 6.0
