"""Simulated vehicles on real sockets against clients nobody here wrote; here MAVSDK, the others in their tests."""

import asyncio
import json
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, aclosing, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.failure import FailureAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.component_type import ComponentType
from mavsdk.plugins.mission_raw.mission_raw import MissionItem

from skyfolio.sim import Fleet, ScaledClock, Vehicle, grid_of
from tests.ports import free_ports

HOME = (47.397742, 8.545594)
FIELDS = (
    *("seq", "frame", "command", "autocontinue", "param1", "param2", "param3", "param4"),
    *("x", "y", "z", "mission_type"),
)
WATCHED = ("HEARTBEAT", "GLOBAL_POSITION_INT", "MISSION_CURRENT", "MISSION_ITEM_REACHED")


@dataclass
class Client:
    """One vehicle as MAVSDK sees it, and the truth beside it."""

    system: Any
    truth: Vehicle
    seen: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.action = ActionAsync(self.system)
        self.missions = MissionRawAsync(self.system)
        self.direct = MavlinkDirectAsync(self.system)
        self.params = ParamAsync(self.system)
        self.telemetry = TelemetryAsync(self.system)
        self.failure = FailureAsync(self.system)

    async def watch(self, name: str) -> None:
        """Keep every message of a name."""
        async with aclosing(self.direct.subscribe_message(name)) as messages:
            async for message in messages:
                self.seen.setdefault(name, []).append(json.loads(message.fields_json))

    def last(self, name: str) -> dict[str, Any]:
        """Return the newest message of a name, or nothing."""
        return self.seen.get(name, [{}])[-1]

    def waypoint(self, seq: int, north_m: float, east_m: float, **values: Any) -> MissionItem:
        """Return a NAV_WAYPOINT 20 m above home; `command` makes it something else."""
        lat, lon = self.truth.autopilot.frame.to_geodetic(east_m, north_m)
        place = {"x": round(lat * 1e7), "y": round(lon * 1e7), "z": 20.0}
        return an_item(seq, **{"command": 16, "param4": math.nan, **place, **values})

    def speed(self, seq: int, mps: float, **values: Any) -> MissionItem:
        """Return a DO_CHANGE_SPEED."""
        return an_item(seq, **{"command": 178, "frame": 2, "param1": 1.0, "param2": mps, "param3": -1.0, **values})

    async def upload_and_compare(self, items: list[MissionItem]) -> None:
        """Upload a mission and read it back field by field (PX4)."""
        await self.missions.upload_mission(items)
        assert fields_of(await self.missions.download_mission()) == fields_of(items)


def an_item(seq: int, **values: Any) -> MissionItem:
    return MissionItem(**{"seq": seq, "frame": 6, "current": 0, "autocontinue": 1, **values})


def fields_of(items: list[MissionItem]) -> list[list[Any]]:
    return [[str(getattr(one, name)) for name in FIELDS] for one in items]


async def wait_until(condition: Callable[[], bool], within_s: float = 90.0) -> None:
    """Wait for something to become true; TimeoutError if it does not."""
    async with asyncio.timeout(within_s):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


@asynccontextmanager
async def mavsdk_clients(
    count: int, speedup: float = 10.0, *, autopilot: str = "px4", one_port: bool = True
) -> AsyncIterator[tuple[Fleet, list[Client]]]:
    """Open a fleet and one MAVSDK that has found all of it, on one port or on a port for each."""
    ports = free_ports(1 if one_port else count)
    endpoint = f"udpout://127.0.0.1:{ports[0]}" + ("" if one_port else f"-{ports[-1]}")
    gcs = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    for port in ports:
        await gcs.add_any_connection(f"udpin://127.0.0.1:{port}")
    fleet = Fleet(grid_of(count, *HOME, autopilot=autopilot), clock=ScaledClock(speedup), endpoint=endpoint)
    async with fleet:
        systems: dict[int, Any] = {}
        async with asyncio.timeout(90.0):
            while len(systems) < count:
                for system in await gcs.get_systems():
                    if await system.has_autopilot():
                        systems[await system.get_system_id()] = system
                await asyncio.sleep(0.02)
        clients = [Client(systems[system_id], vehicle) for system_id, vehicle in fleet.vehicles.items()]
        watches = [asyncio.create_task(client.watch(name)) for client in clients for name in WATCHED]
        try:
            yield fleet, clients
        finally:
            for watch in watches:
                watch.cancel()
            await asyncio.gather(*watches, return_exceptions=True)
            gcs.destroy()


OpenClients = Callable[..., AbstractAsyncContextManager[tuple[Fleet, list[Client]]]]
Until = Callable[..., Awaitable[None]]


@pytest.fixture
def clients_of() -> OpenClients:
    """Opens `clients_of(count, speedup=10, autopilot="px4", one_port=True)`: a fleet, and MAVSDK's view of each."""
    return mavsdk_clients


@pytest.fixture
def until() -> Until:
    """Waits for a condition: `await until(lambda: ...)`."""
    return wait_until
