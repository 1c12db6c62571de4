"""sim.px4_missions: a ground station at one end, an autopilot on the bench at the other."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.missions import Mission
from skyfolio.sim.modes import Mode

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, GroundStation, Items

ACCEPTED = dialect.MAV_MISSION_ACCEPTED


def test_an_uploaded_mission_reads_back_equal(bench: "Bench", items: "Items") -> None:
    sent = [items.speed(4.0, current=1.0), items.waypoint(10.0, 0.0, p1=3.0), items.waypoint(10.0, 20.0)]
    ack = bench.upload(*sent)
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", ACCEPTED)
    (count,) = bench.ask("mission_request_list", 1, 1, 0)
    assert count.count == 3
    for seq, item in enumerate(sent):
        (answer,) = bench.ask("mission_request_int", 1, 1, seq, 0)
        names = ("seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4")
        assert tuple(getattr(answer, name) for name in (*names, "x", "y", "z", "mission_type")) == item
    assert bench.ask("mission_ack", 1, 1, ACCEPTED, 0) == []
    assert not bench.autopilot.missions.busy


def test_the_acknowledgement_carries_the_id_that_mission_current_shows(bench: "Bench", items: "Items") -> None:
    ack = bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    assert ack.opaque_id == bench.autopilot.runner.mission.mission_id != 0
    current = bench.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
    assert current is not None
    assert current.mission_id == ack.opaque_id


def test_a_missing_item_is_requested_again_every_250_ms(bench: "Bench") -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    asked = []
    for _ in range(10):
        bench.wall_s += 0.1
        asked += bench.autopilot.missions.tick()
    assert [request.get_type() for request in asked] == ["MISSION_REQUEST_INT"] * 3
    assert {request.seq for request in asked} == {0}


def test_a_silent_upload_ends_after_five_seconds_and_leaves_the_old_mission(bench: "Bench", items: "Items") -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    old = bench.autopilot.missions.mission
    bench.ask("mission_count", 1, 1, 2, 0)
    bench.wall_s = 5.0
    (words,) = bench.autopilot.missions.tick()
    assert words.get_type() == "STATUSTEXT"
    assert not bench.autopilot.missions.busy
    assert bench.autopilot.missions.mission is old


def test_protocol_timers_ignore_how_fast_the_fleet_flies(bench: "Bench") -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    bench.fly(60.0)
    assert bench.autopilot.missions.busy


def test_an_item_out_of_order_is_ignored(bench: "Bench", items: "Items") -> None:
    first, second = items.waypoint(10.0, 0.0, current=1.0), items.waypoint(20.0, 0.0)
    bench.ask("mission_count", 1, 1, 2, 0)
    assert bench.ask("mission_item_int", 1, 1, *second) == []
    (request,) = bench.ask("mission_item_int", 1, 1, *first)
    assert request.seq == 1
    assert bench.ask("mission_item_int", 1, 1, *first) == []
    (ack,) = bench.ask("mission_item_int", 1, 1, *second)
    assert ack.type == ACCEPTED


def test_an_item_that_cannot_be_flown_ends_the_upload(bench: "Bench", items: "Items") -> None:
    bench.ask("mission_count", 1, 1, 1, 0)
    (ack,) = bench.ask("mission_item_int", 1, 1, *items.add(82))
    assert ack.type == dialect.MAV_MISSION_UNSUPPORTED
    assert not bench.autopilot.missions.busy
    assert bench.autopilot.missions.mission == Mission()


def test_a_late_copy_of_the_last_item_is_acknowledged_again_but_no_other(bench: "Bench", items: "Items") -> None:
    first, last = items.waypoint(10.0, 0.0, current=1.0), items.add(17, p2=float("nan"))
    bench.upload(first, last)
    (again,) = bench.ask("mission_item_int", 1, 1, *last)
    assert again.type == ACCEPTED
    (stray,) = bench.ask("mission_item_int", 1, 1, *first)
    assert stray.type == dialect.MAV_MISSION_ERROR


def test_a_second_ground_station_is_denied_during_a_transfer(
    bench: "Bench", new_station: "Callable[..., GroundStation]"
) -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    foreign = new_station(99, 190).message("mission_count", 1, 1, 5, 0)
    (answer,) = bench.autopilot.handle(foreign)
    assert (answer.type, answer.target_system) == (dialect.MAV_MISSION_DENIED, 99)
    (request,) = bench.ask("mission_count", 1, 1, 2, 0)
    assert request.seq == 0


def test_an_upload_can_be_cancelled(bench: "Bench") -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    assert bench.ask("mission_ack", 1, 1, dialect.MAV_MISSION_OPERATION_CANCELLED, 0) == []
    assert not bench.autopilot.missions.busy


def test_too_many_items_find_no_space(bench: "Bench") -> None:
    (ack,) = bench.ask("mission_count", 1, 1, 501, 0)
    assert ack.type == dialect.MAV_MISSION_NO_SPACE


@pytest.mark.parametrize("message", [("mission_clear_all", 1, 1, 0), ("mission_count", 1, 1, 0, 0)])
def test_a_mission_can_be_cleared(bench: "Bench", items: "Items", message: tuple[Any, ...]) -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    (ack,) = bench.ask(*message)
    assert ack.type == ACCEPTED
    assert bench.autopilot.missions.mission == Mission()


def fence_item(seq: int, command: int, param1: float, north_m: float, east_m: float) -> tuple[Any, ...]:
    """Return the values of a MISSION_ITEM_INT of a fence around the benches' home."""
    x, y = round((47.397742 + north_m / 111_180.0) * 1e7), round((8.545594 + east_m / 75_450.0) * 1e7)
    return (seq, 0, command, 0, 1, param1, 0.0, 0.0, 0.0, x, y, 0.0, 1)


def test_a_fence_is_uploaded_read_back_and_obeyed(airborne: "Bench") -> None:
    corners = [(-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0)]
    sent = [fence_item(seq, 5001, 4.0, *corner) for seq, corner in enumerate(corners)]
    (answer,) = airborne.ask("mission_count", 1, 1, 4, 1)
    for item in sent:
        assert (answer.get_type(), answer.mission_type) == ("MISSION_REQUEST_INT", 1)
        (answer,) = airborne.ask("mission_item_int", 1, 1, *item)
    assert (answer.get_type(), answer.type) == ("MISSION_ACK", ACCEPTED)
    (count,) = airborne.ask("mission_request_list", 1, 1, 1)
    assert count.count == 4
    assert airborne.ask("mission_request_int", 1, 1, 2, 1)[0].x == sent[2][9]
    airborne.autopilot.parameters["GF_ACTION"] = 3
    airborne.autopilot.reposition(80.0, 0.0, None, 8.0)
    airborne.fly_until(lambda: airborne.autopilot.failsafes.active)
    assert airborne.autopilot.body.east_m == pytest.approx(50.0, abs=1.0)
    airborne.fly_until(lambda: airborne.autopilot.mode is Mode.RTL, within_s=5.1)
    assert airborne.autopilot.missions.mission == Mission()


@pytest.mark.parametrize(
    "items", [[(5001, 3.0)] * 2, [(5001, 3.0), (5001, 3.0), (5002, 3.0)], [(5001, 2.0), (5001, 2.0)]]
)
def test_a_polygon_that_does_not_add_up_is_refused(bench: "Bench", items: list[tuple[int, float]]) -> None:
    (answer,) = bench.ask("mission_count", 1, 1, len(items), 1)
    for seq, (command, param1) in enumerate(items):
        (answer,) = bench.ask("mission_item_int", 1, 1, *fence_item(seq, command, param1, 10.0 * seq, 0.0))
    assert (answer.get_type(), answer.type) == ("MISSION_ACK", dialect.MAV_MISSION_ERROR)
    assert len(bench.autopilot.missions.plan(1)) == 0


def test_a_return_goes_to_the_nearest_rally_point(airborne: "Bench", items: "Items") -> None:
    rally = (*items.add(5100, north_m=60.0, frame=3.0, up_m=20.0)[:-1], 2)
    airborne.ask("mission_count", 1, 1, 1, 2)
    assert airborne.ask("mission_item_int", 1, 1, *rally)[0].type == ACCEPTED
    airborne.autopilot.reposition(0.0, 80.0, None, 8.0)
    airborne.fly(25.0)
    airborne.command(20)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    assert airborne.autopilot.body.distance_to(0.0, 60.0) < 0.5


def test_a_mission_type_it_does_not_have_is_unsupported(bench: "Bench") -> None:
    (ack,) = bench.ask("mission_count", 1, 1, 3, 7)
    assert ack.type == dialect.MAV_MISSION_UNSUPPORTED


def test_a_request_past_the_end_of_a_download_is_an_invalid_sequence(bench: "Bench", items: "Items") -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    bench.ask("mission_request_list", 1, 1, 0)
    (ack,) = bench.ask("mission_request_int", 1, 1, 1, 0)
    assert ack.type == dialect.MAV_MISSION_INVALID_SEQUENCE


def test_setting_the_current_item_has_no_answer_but_past_the_end_it_has(bench: "Bench", items: "Items") -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0), items.waypoint(20.0, 0.0))
    bench.autopilot.due()
    assert bench.ask("mission_set_current", 1, 1, 1) == []
    assert bench.autopilot.runner.index == 1
    assert [message for message in bench.autopilot.due() if message.get_type() == "MISSION_CURRENT"] == []
    (words,) = bench.ask("mission_set_current", 1, 1, 2)
    assert words.get_type() == "STATUSTEXT"
    assert bench.autopilot.runner.index == 1
