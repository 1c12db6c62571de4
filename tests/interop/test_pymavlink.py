"""Both flavours against pymavlink's own helpers: mavutil's connection, mavwp's loader and mavparm's dictionary"""

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavparm, mavutil, mavwp

from skyfolio.sim import Fleet, ScaledClock, grid_of

HOME = (47.397742, 8.545594)
WAYPOINTS = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.39774200\t8.54559400\t488.000000\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.39774200\t8.54559400\t20.000000\t1
2\t0\t3\t16\t0\t0\t0\t0\t47.39800000\t8.54559400\t20.000000\t1
3\t0\t3\t16\t0\t0\t0\t0\t47.39800000\t8.54600000\t20.000000\t1
"""
pytestmark = pytest.mark.e2e


async def with_pymavlink(autopilot: str, port: int, talk: Callable[[Any, Fleet], None], system_id: int = 255) -> Fleet:
    """Fly a fleet of one, and let `talk(connection, fleet)` speak to it in a thread: pymavlink blocks."""
    ended = threading.Event()

    def session(fleet: Fleet) -> None:
        connection = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{port}", dialect="ardupilotmega", source_system=system_id
        )
        try:
            connection.wait_heartbeat(timeout=10)
            talk(connection, fleet)
        finally:
            connection.close()
            ended.set()

    fleet = Fleet(
        grid_of(1, *HOME, autopilot=autopilot), clock=ScaledClock(10.0), endpoint=f"udpout://127.0.0.1:{port}"
    )
    async with fleet, asyncio.timeout(60):
        await asyncio.to_thread(session, fleet)
    assert ended.is_set()
    return fleet


def load(connection: Any, path: Path) -> Any:
    """Return pymavlink's loader with the mission of a file."""
    path.write_text(WAYPOINTS)
    loader = mavwp.MAVWPLoader(connection.target_system, connection.target_component)
    assert loader.load(str(path)) == 4
    return loader


def upload(connection: Any, loader: Any) -> int:
    """Upload with float items, as pymavlink's loader has them, or their INT twins; return the MAV_MISSION_RESULT."""
    connection.waypoint_count_send(loader.count())
    while True:
        asked = connection.recv_match(
            type=["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=5
        )
        assert asked is not None
        if asked.get_type() == "MISSION_ACK":
            return int(asked.type)
        item = loader.wp(asked.seq)
        if asked.get_type() == "MISSION_REQUEST_INT":
            item = mavutil.mavlink.MAVLink_mission_item_int_message(
                *(item.target_system, item.target_component, item.seq, item.frame, item.command),
                *(item.current, item.autocontinue, item.param1, item.param2, item.param3, item.param4),
                *(round(item.x * 1e7), round(item.y * 1e7), item.z),
            )
        connection.mav.send(item)


def download(connection: Any) -> list[Any]:
    """Read the mission back with pymavlink's requests."""
    connection.waypoint_request_list_send()
    count = connection.recv_match(type="MISSION_COUNT", blocking=True, timeout=5)
    items = []
    for seq in range(count.count):
        connection.waypoint_request_send(seq)
        items.append(connection.recv_match(type=["MISSION_ITEM", "MISSION_ITEM_INT"], blocking=True, timeout=5))
    return items


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
async def test_mavwp_uploads_and_reads_back(autopilot: str, free_port: int, tmp_path: Path) -> None:
    def talk(connection: Any, fleet: Fleet) -> None:
        loader = load(connection, tmp_path / "mission.txt")
        assert upload(connection, loader) == mavutil.mavlink.MAV_MISSION_ACCEPTED
        got = download(connection)
        assert [item.command for item in got] == [16, 22, 16, 16]
        scale = 1e7 if got[2].get_type() == "MISSION_ITEM_INT" else 1.0
        assert got[2].x / scale == pytest.approx(47.398, abs=4e-6)
        assert len(fleet.vehicles[1].mission) == 4

    await with_pymavlink(autopilot, free_port, talk)


@pytest.mark.parametrize(
    ("autopilot", "name", "value"), [("px4", "NAV_ACC_RAD", 3.5), ("ardupilot", "WPNAV_SPEED", 650.0)]
)
async def test_mavparm_sets_with_acknowledgement_and_everything_is_fetched(
    autopilot: str, name: str, value: float, free_port: int
) -> None:
    def talk(connection: Any, fleet: Fleet) -> None:
        assert mavparm.MAVParmDict().mavset(connection, name, value, retries=3)
        assert fleet.vehicles[1].autopilot.parameters[name] == value
        connection.param_fetch_all()
        got: dict[str, Any] = {}
        while True:
            message = connection.recv_match(type="PARAM_VALUE", blocking=True, timeout=5)
            got[message.param_id] = message.param_value
            if len(got) == message.param_count:
                break
        assert got[name] == value

    await with_pymavlink(autopilot, free_port, talk)


async def test_mavutil_flies_an_arducopter(free_port: int, tmp_path: Path) -> None:
    def talk(connection: Any, _: Fleet) -> None:
        assert upload(connection, load(connection, tmp_path / "mission.txt")) == mavutil.mavlink.MAV_MISSION_ACCEPTED
        connection.set_mode("GUIDED")
        connection.arducopter_arm()
        connection.motors_armed_wait()
        connection.mav.command_long_send(1, 1, mavutil.mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 15)
        connection.mav.request_data_stream_send(1, 1, mavutil.mavlink.MAV_DATA_STREAM_ALL, 5, 1)
        while True:
            position = connection.recv_match(type="GLOBAL_POSITION_INT", blocking=True, timeout=10)
            if position.relative_alt > 14_000:
                break
        connection.set_mode("AUTO")
        reached = connection.recv_match(
            type="MISSION_ITEM_REACHED", condition="MISSION_ITEM_REACHED.seq==2", blocking=True, timeout=20
        )
        assert reached is not None
        connection.set_mode_rtl()
        connection.motors_disarmed_wait()
        assert connection.flightmode == "RTL"

    fleet = await with_pymavlink("ardupilot", free_port, talk)
    assert fleet.vehicles[1].autopilot.body.distance_to(0.0, 0.0) < 0.5


async def test_mavutil_flies_a_px4(free_port: int, tmp_path: Path) -> None:
    def talk(connection: Any, _: Fleet) -> None:
        assert upload(connection, load(connection, tmp_path / "mission.txt")) == mavutil.mavlink.MAV_MISSION_ACCEPTED
        connection.mav.command_long_send(1, 1, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
        connection.motors_armed_wait()
        connection.set_mode("MISSION")
        assert connection.recv_match(
            type="MISSION_ITEM_REACHED", condition="MISSION_ITEM_REACHED.seq==2", blocking=True, timeout=20
        )
        connection.set_mode("RTL")
        connection.motors_disarmed_wait()

    fleet = await with_pymavlink("px4", free_port, talk)
    assert fleet.vehicles[1].autopilot.body.distance_to(0.0, 0.0) < 0.5
