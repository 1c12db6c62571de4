"""sim.telemetry_streams"""

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, Items


def names(messages: list[Any]) -> Counter[str]:
    return Counter(message.get_type() for message in messages)


def test_heartbeats_are_sent_once_a_second_and_positions_at_five_hertz(bench: "Bench") -> None:
    bench.fly(20.0)
    sent = names(bench.sent)
    assert 20 <= sent["HEARTBEAT"] <= 21
    assert 100 <= sent["GLOBAL_POSITION_INT"] <= 101
    assert 20 <= sent["MISSION_CURRENT"] <= 21


def test_the_heartbeat_describes_a_px4_quadrotor_and_its_mode(airborne: "Bench") -> None:
    beat: Any = airborne.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_HEARTBEAT)
    assert (beat.autopilot, beat.type) == (dialect.MAV_AUTOPILOT_PX4, dialect.MAV_TYPE_QUADROTOR)
    assert beat.custom_mode == 0x03040000
    assert beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED


def test_the_position_is_where_it_is(airborne: "Bench") -> None:
    airborne.autopilot.reposition(100.0, 0.0, None, 5.0)
    airborne.fly(8.0)
    position: Any = airborne.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    east, north = airborne.autopilot.frame.to_local(position.lat / 1e7, position.lon / 1e7)
    assert airborne.autopilot.body.distance_to(east, north) < 0.02
    assert position.relative_alt == round(airborne.autopilot.body.up_m * 1000.0)
    assert position.alt - position.relative_alt == 488_000
    assert (position.vx, position.vy) == (0, 500)
    assert position.hdg == pytest.approx(9000, abs=10)
    assert position.time_boot_ms == pytest.approx((airborne.autopilot.now_s + 60.0) * 1000.0, abs=1.0)


def test_a_stream_can_be_set_faster_off_and_back_to_its_default(bench: "Bench") -> None:
    def heard_in_ten_seconds() -> int:
        bench.sent.clear()
        bench.fly(10.0)
        return names(bench.sent)["VFR_HUD"]

    assert bench.command(511, float(dialect.MAVLINK_MSG_ID_VFR_HUD), 100_000.0) == 0
    assert 99 <= heard_in_ten_seconds() <= 101
    bench.command(511, float(dialect.MAVLINK_MSG_ID_VFR_HUD), -1.0)
    assert heard_in_ten_seconds() == 0
    bench.command(511, float(dialect.MAVLINK_MSG_ID_VFR_HUD), 0.0)
    assert 10 <= heard_in_ten_seconds() <= 11


def test_a_message_that_is_not_streamed_by_default_goes_off_again(bench: "Bench") -> None:
    version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert bench.command(511, version, 1e6) == 0
    assert bench.command(511, version, 0.0) == 0
    bench.fly(5.0)
    assert names(bench.sent)["AUTOPILOT_VERSION"] <= 1
    assert bench.command(511, 9999.0, 1e6) == dialect.MAV_RESULT_FAILED
    assert bench.command(511, version, math.nan) == dialect.MAV_RESULT_DENIED


def test_the_landed_state_follows_the_flight(bench: "Bench") -> None:
    def state() -> int:
        message: Any = bench.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        return int(message.landed_state)

    assert state() == dialect.MAV_LANDED_STATE_ON_GROUND
    bench.command(400, 1.0)
    bench.command(22, *[math.nan] * 7)
    bench.fly(0.5)
    assert state() == dialect.MAV_LANDED_STATE_TAKEOFF
    bench.fly(10.0)
    assert state() == dialect.MAV_LANDED_STATE_IN_AIR
    bench.command(21)
    bench.fly(0.5)
    assert state() == dialect.MAV_LANDED_STATE_LANDING


def test_the_mission_state_follows_the_mission(airborne: "Bench", items: "Items") -> None:
    def state() -> int:
        message: Any = airborne.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        return int(message.mission_state)

    assert state() == dialect.MISSION_STATE_NO_MISSION
    airborne.upload(items.waypoint(30.0, 0.0, current=1.0), items.waypoint(90.0, 0.0))
    assert state() == dialect.MISSION_STATE_NOT_STARTED
    airborne.set_mode(4)
    assert state() == dialect.MISSION_STATE_ACTIVE
    airborne.fly_until(lambda: airborne.reached() == [0])
    airborne.set_mode(3)
    assert state() == dialect.MISSION_STATE_PAUSED
    airborne.set_mode(4)
    airborne.fly(30.0)
    assert state() == dialect.MISSION_STATE_COMPLETE


def test_a_px4s_takeoff_by_command_counts_as_a_mission_that_is_done(airborne: "Bench", items: "Items") -> None:
    reports: list[Any] = [m for m in airborne.sent if m.get_type() == "MISSION_CURRENT"]
    assert {m.mission_state for m in reports} == {dialect.MISSION_STATE_NO_MISSION}
    airborne.set_mode(6)
    airborne.fly_until(lambda: not airborne.autopilot.armed)
    airborne.upload(items.waypoint(30.0, 0.0, current=1.0))
    airborne.sent.clear()
    airborne.take_off()
    reports = [(m.mission_state, m.mission_mode) for m in airborne.sent if m.get_type() == "MISSION_CURRENT"]
    assert list(dict.fromkeys(reports)) == [(3, 1), (5, 2)]


def test_an_arducopters_mission_is_not_started_whenever_it_is_not_flown(copter_up: "Bench", items: "Items") -> None:
    def state_and_mode() -> tuple[int, int]:
        message: Any = copter_up.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        return int(message.mission_state), int(message.mission_mode)

    assert state_and_mode() == (dialect.MISSION_STATE_NO_MISSION, 0)
    copter_up.upload(items.waypoint(0.0, 0.0), items.waypoint(30.0, 0.0), items.waypoint(90.0, 0.0))
    assert state_and_mode() == (dialect.MISSION_STATE_NOT_STARTED, 0)
    copter_up.set_mode(3)
    assert state_and_mode() == (dialect.MISSION_STATE_ACTIVE, 1)
    copter_up.fly_until(lambda: copter_up.reached() == [1])
    copter_up.set_mode(4)
    assert state_and_mode() == (dialect.MISSION_STATE_NOT_STARTED, 0)


def test_each_item_that_is_done_is_announced(airborne: "Bench", items: "Items") -> None:
    airborne.upload(items.speed(5.0, current=1.0), items.waypoint(20.0, 0.0), items.waypoint(40.0, 0.0))
    airborne.set_mode(4)
    airborne.fly(30.0)
    reports = [m.seq for m in airborne.sent if m.get_type() == "MISSION_ITEM_REACHED"]
    assert list(dict.fromkeys(reports)) == [0, 1, 2]
    assert reports.count(2) == 11


def test_of_items_done_at_once_only_the_last_is_announced(copter_up: "Bench", items: "Items") -> None:
    legs = (items.waypoint(20.0, 0.0), items.speed(5.0), items.speed(6.0), items.waypoint(90.0, 0.0))
    copter_up.upload(*((seq, *item[1:]) for seq, item in enumerate((items.waypoint(0.0, 0.0), *legs))))
    copter_up.set_mode(3)
    copter_up.fly_until(lambda: copter_up.autopilot.runner.complete)
    assert copter_up.reached() == [1, 2, 3, 4]
    assert [m.seq for m in copter_up.sent if m.get_type() == "MISSION_ITEM_REACHED"] == [3, 4]
    words = [m.text for m in copter_up.sent if m.get_type() == "STATUSTEXT"]
    assert [w for w in words if w.startswith(("Mission", "Reached"))] == [
        "Mission: 1 WP",
        "Reached command #1",
        "Mission: 2 ChangeSpeed",
        "Mission: 3 ChangeSpeed",
        "Mission: 4 WP",
        "Reached command #4",
    ]


def test_every_message_can_be_built_and_packed(airborne: "Bench") -> None:
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for message_id in (0, 1, 24, 30, 31, 32, 33, 42, 74, 147, 148, 242, 245):
        message = airborne.autopilot.telemetry.build(message_id)
        assert message is not None
        assert message.pack(mav)


def test_the_battery_drains_in_the_air_only(bench: "Bench") -> None:
    def remaining() -> int:
        message: Any = bench.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_BATTERY_STATUS)
        return int(message.battery_remaining)

    bench.fly(100.0)
    assert remaining() == 100
    bench.take_off()
    bench.fly(150.0)
    assert 88 <= remaining() <= 90
