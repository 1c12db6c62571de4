"""Reports of missions, measured on real autopilots (ArduCopter 4.6.2, PX4 1.18); the simulated ones send them too."""

from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, Items

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
AUTO, PX4_MISSION = 3, 4
FENCE, RALLY = dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_RALLY
SET_CURRENT, INTERVAL, REQUEST = 224, 511, 512
MISSION_CURRENT = dialect.MAVLINK_MSG_ID_MISSION_CURRENT
LAND = dialect.MAV_CMD_NAV_LAND


def flight(items: "Items", *, home: bool) -> list[Any]:
    """Return (home,) take-off, speed, waypoint, speed, waypoint, land."""
    before = [items.waypoint(0.0, 0.0, 0.0)] if home else []
    legs = [items.speed(4.0), items.waypoint(60.0, 0.0), items.speed(5.0), items.waypoint(60.0, 60.0)]
    whole = [*before, items.add(22, up_m=20.0), *legs, items.add(LAND, north_m=60.0, east_m=60.0, up_m=0.0)]
    return [(seq, *item[1:3], int(seq == 0), *item[4:]) for seq, item in enumerate(whole)]


def uploaded(bench: "Bench", kind: int, *items: Any) -> list[Any]:
    """Upload items of a MAV_MISSION_TYPE and return them as they are read back."""
    (answer,) = bench.ask("mission_count", 1, 1, len(items), kind)
    for item in items:
        answer = bench.ask("mission_item_int", 1, 1, *item[:-1], kind)[-1]
    assert (answer.get_type(), answer.type) == ("MISSION_ACK", ACCEPTED)
    return read_back(bench, kind)


def read_back(bench: "Bench", kind: int) -> list[Any]:
    (count,) = bench.ask("mission_request_list", 1, 1, kind)
    total = getattr(count, "base", count).count
    read = [bench.ask("mission_request_int", 1, 1, seq, kind)[0] for seq in range(total)]
    bench.ask("mission_ack", 1, 1, 0, kind)
    return read


def current(bench: "Bench") -> Any:
    """Return the MISSION_CURRENT it would send now."""
    message = bench.autopilot.telemetry.build(MISSION_CURRENT)
    return getattr(message, "base", message)


def fenced(items: "Items") -> list[Any]:
    """Return a polygon to stay in, one to stay out of, and a circle of each kind."""
    corners = [(0.0, 0.0), (0.0, 90.0), (90.0, 90.0)]
    polygons = [
        items.add(command, north_m=north, east_m=east, up_m=0.0, frame=3, p1=3.0)
        for command in (5001, 5002)
        for north, east in corners
    ]
    return [*polygons, items.add(5003, up_m=0.0, frame=3, p1=80.0), items.add(5004, up_m=0.0, frame=3, p1=7.25)]


def test_a_copter_reads_a_sign_back_for_what_a_landing_was_given_as_param4(copter: "Bench", items: "Items") -> None:
    copter.upload(*flight(items, home=True))
    landing = read_back(copter, 0)[-1]
    assert (landing.command, landing.param4) == (LAND, 1.0)


def test_a_copter_reads_fence_and_rally_points_back_without_autocontinue(copter: "Bench", items: "Items") -> None:
    fence = uploaded(copter, FENCE, *fenced(items))
    assert {(item.autocontinue, item.frame, item.z) for item in fence} == {(0, 0, 0.0)}
    assert [item.param1 for item in fence] == [3.0] * 6 + [80.0, 7.25]
    items.seq = 0
    (rally,) = uploaded(copter, RALLY, items.add(5100, north_m=9.0, up_m=42.9, frame=3))
    assert (rally.autocontinue, rally.frame, rally.z) == (0, 3, 42.0)


def test_a_px4_reads_fences_back_without_autocontinue_and_frame_but_rally_points_with_both(
    bench: "Bench", items: "Items"
) -> None:
    fence = uploaded(bench, FENCE, *fenced(items))
    assert {(item.autocontinue, item.frame) for item in fence} == {(0, dialect.MAV_FRAME_GLOBAL_INT)}
    items.seq = 0
    (rally,) = uploaded(bench, RALLY, items.add(5100, north_m=9.0, up_m=42.5, frame=3))
    assert (rally.autocontinue, rally.frame) == (1, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
    assert rally.z == pytest.approx(42.5)


def test_a_copter_does_not_count_home_among_its_items(copter: "Bench", items: "Items") -> None:
    assert current(copter).total == 0
    six = flight(items, home=True)[:6]
    copter.upload(*six)
    assert current(copter).total == 5


def test_a_px4_counts_every_item_and_reports_unknown_for_none(bench: "Bench", items: "Items") -> None:
    assert current(bench).total == 0xFFFF
    bench.upload(*flight(items, home=False))
    assert current(bench).total == 6


@pytest.mark.parametrize("flying", [False, True])
def test_a_copter_set_to_a_speed_change_reports_the_waypoint_after_it(
    copter_up: "Bench", items: "Items", flying: bool
) -> None:
    copter_up.upload(*flight(items, home=True))
    if flying:
        assert copter_up.set_mode(AUTO) == ACCEPTED
    assert copter_up.command(SET_CURRENT, 4.0) == ACCEPTED
    heard = [message.seq for message in copter_up.autopilot.due() if message.get_type() == "MISSION_CURRENT"]
    assert heard == [5]
    assert copter_up.set_mode(AUTO) == ACCEPTED
    copter_up.fly(0.2)
    assert copter_up.autopilot.runner.speed_mps == 5.0


def test_a_copter_answers_the_message_with_the_item_set_and_then_reports_the_one_it_flies(
    copter_up: "Bench", items: "Items"
) -> None:
    copter_up.upload(*flight(items, home=True))
    (answer,) = copter_up.ask("mission_set_current", 1, 1, 2)
    assert (answer.get_type(), answer.seq) == ("MISSION_CURRENT", 2)
    assert current(copter_up).seq == 3


def test_a_copter_denies_an_item_it_does_not_have(copter_up: "Bench", items: "Items") -> None:
    copter_up.upload(*flight(items, home=True))
    assert copter_up.command(SET_CURRENT, 7.0) == DENIED
    assert copter_up.command(SET_CURRENT, float("nan")) == DENIED


def test_a_px4_knows_no_command_to_set_the_current_item(bench: "Bench", items: "Items") -> None:
    bench.upload(*flight(items, home=False))
    assert bench.command(SET_CURRENT, 1.0) == UNSUPPORTED
    assert current(bench).seq == 0


def test_a_px4_does_not_send_its_current_item_on_request(bench: "Bench") -> None:
    assert bench.command(REQUEST, float(MISSION_CURRENT)) == DENIED
    assert bench.command(INTERVAL, float(MISSION_CURRENT), 2e5) == FAILED
    bench.fly(5.0)
    heard = [message for message in bench.sent if message.get_type() == "MISSION_CURRENT"]
    assert 5 <= len(heard) <= 6


def test_a_px4_in_flight_moves_on_from_a_speed_to_the_waypoint_after_it(airborne: "Bench", items: "Items") -> None:
    airborne.upload(*flight(items, home=False))
    airborne.ask("mission_set_current", 1, 1, 3)
    assert current(airborne).seq == 3  # it does not fly its mission yet
    assert airborne.set_mode(PX4_MISSION) == ACCEPTED
    airborne.fly(0.2)
    assert current(airborne).seq == 4
    airborne.ask("mission_set_current", 1, 1, 1)
    airborne.fly(0.2)
    assert current(airborne).seq == 2
