"""The contract of the port through which the link speaks MAVLink, for MAVSDK and for what stands in for it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from math import isnan, nan
from typing import Any

import pytest
import pytest_asyncio
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.api.lab.virtual.wire import MemoryMessages
from skyfolio.mavlink_bridge.mavsdk_port import MavsdkPort
from skyfolio.mavlink_bridge.message_port import MessagePort, NotSentError, OpenPort
from skyfolio.mavlink_bridge.mission_messages import GROUND, Message
from skyfolio.sim.wire import Decoder, Extended

PORTS: dict[str, OpenPort] = {"mavsdk": MavsdkPort, "memory": MemoryMessages}
HEARTBEAT = dialect.MAVLink_heartbeat_message(2, 12, 81, 0x01020304, 4, 3)


class Side:
    """A port, the vehicles' side of it, and what comes out on ours."""

    def __init__(self, open_port: OpenPort) -> None:
        self.sent: list[bytes] = []
        self.news = 0
        self.heard: list[tuple[str, dict[str, Any], float]] = []
        self.port: MessagePort = open_port(lambda: 4.5, self.sent.append, self._note)
        self._encoders: dict[tuple[int, int], Any] = {}

    def _note(self) -> None:
        self.news += 1

    def vehicle_sends(self, message: Any, system_id: int = 1, component_id: int = 1) -> None:
        mav = self._encoders.setdefault(
            (system_id, component_id), dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        )
        frame = message.pack(mav)
        mav.seq = (mav.seq + 1) % 256
        self.port.take_in(bytes(frame))

    async def discovered(self, system_id: int = 1) -> None:
        self.vehicle_sends(HEARTBEAT, system_id)
        async with asyncio.timeout(60):
            while system_id not in await self.port.systems():  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    async def listening(self, *names: str) -> None:
        await self.discovered()
        self.port.listen(1, names, lambda name, fields, heard_s: self.heard.append((name, fields, heard_s)))

    async def hears(self, message: Any) -> dict[str, Any]:
        """The fields of this message, as they were handed over."""
        before = len(self.heard)
        self.vehicle_sends(message)
        await until(lambda: len(self.heard) > before)
        name, fields, heard_s = self.heard[-1]
        assert (name, heard_s) == (message.get_type(), 4.5)
        return fields

    async def vehicle_gets(self, message: Message) -> Any:
        """This message of ours, as a vehicle decodes it; MAVSDK also sends commands of its own."""

        def found() -> list[Any]:
            command = message.fields.get("command")
            same = [one for one in self.received() if one.get_type() == message.name]
            return [one for one in same if command is None or one.command == command]

        self.port.send(1, message)
        await until(found)
        return found()[0]

    def received(self) -> list[Any]:
        decoder = Decoder()
        return [message for data in list(self.sent) for message in decoder.decode(data)]


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


@pytest_asyncio.fixture(params=PORTS)
async def side(request: pytest.FixtureRequest) -> AsyncIterator[Side]:
    made = Side(PORTS[request.param])
    yield made
    await made.port.close()


async def test_each_system_that_is_heard_is_discovered_and_that_is_said(side: Side) -> None:
    assert list(await side.port.systems()) == []
    await side.discovered(1)
    await side.discovered(7)
    assert sorted(await side.port.systems()) == [1, 7]
    await until(lambda: side.news >= 2)


async def test_numbers_are_handed_over_by_their_names_with_the_time_of_their_arrival(side: Side) -> None:
    await side.listening("GLOBAL_POSITION_INT", "HEARTBEAT")
    fields = await side.hears(
        dialect.MAVLink_global_position_int_message(4_000_000_000, 473977420, -85455940, -5000, 60000, -3, 4, 0, 0)
    )
    assert (
        fields.items()
        >= {
            "time_boot_ms": 4_000_000_000,
            "lat": 473977420,
            "lon": -85455940,
            "alt": -5000,
            "relative_alt": 60000,
            "vx": -3,
            "vy": 4,
            "vz": 0,
            "hdg": 0,
        }.items()
    )
    fields = await side.hears(HEARTBEAT)
    assert fields.items() >= {"type": 2, "autopilot": 12, "base_mode": 81, "custom_mode": 0x01020304}.items()


async def test_nan_is_none_and_text_is_text(side: Side) -> None:
    await side.listening("MISSION_ITEM_INT", "PARAM_VALUE", "STATUSTEXT")
    item = await side.hears(
        dialect.MAVLink_mission_item_int_message(245, 190, 3, 6, 16, 0, 1, 0.5, 0.0, nan, nan, 1, 2, 60.25, 1)
    )
    assert item["param3"] is item["param4"] is None
    assert (item["seq"], item["frame"], item["param1"], item["x"], item["y"], item["z"], item["mission_type"]) == (
        *(3, 6, 0.5, 1, 2, 60.25, 1),
    )
    value = await side.hears(dialect.MAVLink_param_value_message(b"MPC_XY_CRUISE", 5.1, 9, 900, 65535))
    assert (value["param_id"], value["param_index"]) == ("MPC_XY_CRUISE", 65535)
    assert value["param_value"] == pytest.approx(5.1, rel=1e-6)
    said = await side.hears(dialect.MAVLink_statustext_message(4, b"Arm: Need Position Estimate", 0, 0))
    assert (said["severity"], said["text"], said.get("id", 0)) == (4, "Arm: Need Position Estimate", 0)


async def test_the_newest_extension_fields_are_read(side: Side) -> None:
    await side.listening("MISSION_CURRENT", "MISSION_ACK", "MISSION_COUNT")
    current = await side.hears(
        Extended(dialect.MAVLink_mission_current_message(2, 7, 3, 1), mission_id=77, fence_id=0, rally_points_id=9)
    )
    assert [current[name] for name in ("seq", "total", "mission_state", "mission_id")] == [2, 7, 3, 77]
    ack = await side.hears(Extended(dialect.MAVLink_mission_ack_message(245, 190, 0, 0), opaque_id=2**32 - 1))
    assert (ack["type"], ack["opaque_id"]) == (0, 2**32 - 1)
    count = await side.hears(Extended(dialect.MAVLink_mission_count_message(245, 190, 12, 0), opaque_id=5))
    assert (count["count"], count["opaque_id"]) == (12, 5)


async def test_only_what_the_autopilot_itself_sends_and_what_is_listened_to_is_handed_over(side: Side) -> None:
    await side.listening("HEARTBEAT")
    side.vehicle_sends(HEARTBEAT, component_id=191)
    side.vehicle_sends(HEARTBEAT, system_id=2)
    side.vehicle_sends(dialect.MAVLink_mission_current_message(1, 2, 3, 1))
    await side.hears(HEARTBEAT)
    assert len(side.heard) == 1


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        (
            "COMMAND_LONG",
            {
                "command": 176,
                "confirmation": 2,
                "target_system": 1,
                "target_component": 1,
                "param1": 1.5,
                "param2": None,
                "param3": 0.0,
                "param4": -1.0,
                "param5": 0.0,
                "param6": 0.0,
                "param7": 9.25,
            },
        ),
        (
            "COMMAND_INT",
            {
                "command": 192,
                "target_system": 1,
                "target_component": 1,
                "frame": 6,
                "x": 473977420,
                "y": -5,
                "z": 60.0,
                "param1": -1.0,
                "param2": 1.0,
                "param3": 0.0,
                "param4": None,
            },
        ),
        (
            "MISSION_ITEM_INT",
            {
                "target_system": 1,
                "target_component": 1,
                "seq": 4,
                "frame": 6,
                "command": 16,
                "current": 0,
                "autocontinue": 1,
                "param1": 2.5,
                "param2": 0.0,
                "param3": 0.0,
                "param4": None,
                "x": 7,
                "y": -8,
                "z": 60.5,
                "mission_type": 1,
            },
        ),
        (
            "PARAM_REQUEST_READ",
            {"target_system": 1, "target_component": 1, "param_id": "WPNAV_ACCEL", "param_index": -1},
        ),
    ],
)
async def test_a_vehicle_gets_what_is_sent_from_our_ground_station(
    side: Side, name: str, fields: dict[str, Any]
) -> None:
    await side.listening("HEARTBEAT")
    got = await side.vehicle_gets(Message(name, fields))
    assert (got.get_srcSystem(), got.get_srcComponent()) == GROUND
    for field, value in fields.items():
        found = getattr(got, field)
        assert isnan(found) if value is None else found == value, field


async def test_our_heartbeat_is_sent_again_and_again_once_a_system_was_heard(side: Side) -> None:
    await side.discovered()

    def beats() -> list[Any]:
        return [one for one in side.received() if one.get_type() == "HEARTBEAT"]

    await until(lambda: len(beats()) >= 2)
    assert {(one.get_srcSystem(), one.type, one.autopilot) for one in beats()} == {(GROUND[0], 6, 8)}


async def test_a_message_that_does_not_exist_is_not_sent(side: Side) -> None:
    await side.listening("HEARTBEAT")
    with pytest.raises(NotSentError):
        side.port.send(1, Message("NO_SUCH_MESSAGE", {}))
