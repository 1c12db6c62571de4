"""The fleet against a client nobody here wrote: MAVSDK's asyncio API on loopback UDP, all vehicles on one port."""

import asyncio
import json
import math
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.component_type import ComponentType
from mavsdk.plugins.mission_raw.mission_raw import MissionItem

from sim import Fleet, Kill, Mode, ScaledClock, Vehicle, grid_of
from sim.flavours import PX4

HOME = (47.397742, 8.545594)
NAN = math.nan
FIELDS = (
    "seq",
    "frame",
    "command",
    "autocontinue",
    "param1",
    "param2",
    "param3",
    "param4",
    "x",
    "y",
    "z",
    "mission_type",
)


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

    async def watch(self, name: str) -> None:
        """Keep every message of a name."""
        async with aclosing(self.direct.subscribe_message(name)) as messages:
            async for message in messages:
                self.seen.setdefault(name, []).append(json.loads(message.fields_json))

    def last(self, name: str) -> dict[str, Any]:
        """Return the newest message of a name, or nothing."""
        return self.seen.get(name, [{}])[-1]


@asynccontextmanager
async def clients_of(count: int, speedup: float, port: int) -> AsyncIterator[tuple[Fleet, list[Client]]]:
    gcs = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await gcs.add_any_connection(f"udpin://127.0.0.1:{port}")
    fleet = Fleet(grid_of(count, *HOME), clock=ScaledClock(speedup), endpoint=f"udpout://127.0.0.1:{port}")
    async with fleet:
        systems: dict[int, Any] = {}
        async with asyncio.timeout(10.0):
            while len(systems) < count:
                for system in await gcs.get_systems():
                    if await system.has_autopilot():
                        systems[await system.get_system_id()] = system
                await asyncio.sleep(0.02)
        clients = [Client(systems[system_id], vehicle) for system_id, vehicle in fleet.vehicles.items()]
        names = ("HEARTBEAT", "GLOBAL_POSITION_INT", "MISSION_CURRENT", "MISSION_ITEM_REACHED")
        watches = [asyncio.create_task(client.watch(name)) for client in clients for name in names]
        try:
            yield fleet, clients
        finally:
            for watch in watches:
                watch.cancel()
            await asyncio.gather(*watches, return_exceptions=True)
            gcs.destroy()


async def until(condition: Callable[[], bool], within_s: float = 30.0) -> None:
    async with asyncio.timeout(within_s):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def first(stream: Any) -> Any:
    """Return the first value of a subscription."""
    async with aclosing(stream), asyncio.timeout(5.0):
        return await anext(stream)


def item(seq: int, command: int, *, current: int = 0, **values: Any) -> MissionItem:
    return MissionItem(**{"seq": seq, "frame": 6, "command": command, "current": current, "autocontinue": 1, **values})


def waypoint(client: Client, seq: int, north_m: float, east_m: float, **values: Any) -> MissionItem:
    lat, lon = client.truth.autopilot.frame.to_geodetic(east_m, north_m)
    place = {"x": round(lat * 1e7), "y": round(lon * 1e7), "z": 20.0}
    return item(seq, 16, **{"param4": NAN, **place, **values})


def speed(seq: int, mps: float, **values: Any) -> MissionItem:
    return item(seq, 178, **{"frame": 2, "param1": 1.0, "param2": mps, "param3": -1.0, **values})


def fields_of(items: list[MissionItem]) -> list[list[Any]]:
    return [[str(getattr(one, name)) for name in FIELDS] for one in items]


async def upload_and_compare(client: Client, items: list[MissionItem]) -> None:
    await client.missions.upload_mission(items)
    assert fields_of(await client.missions.download_mission()) == fields_of(items)


async def test_mavsdk_finds_every_vehicle_on_one_port_and_moves_missions_and_parameters(free_port: int) -> None:
    async with clients_of(3, 10.0, free_port) as (fleet, clients):
        for client in clients:
            items = [
                speed(0, 4.5, current=1),
                waypoint(client, 1, 10.0, 5.0, param1=3.0),
                waypoint(client, 2, 20.0, 0.0),
            ]
            await upload_and_compare(client, items)
            await client.action.set_takeoff_altitude(17.0)
            assert client.truth.autopilot.parameters["MIS_TAKEOFF_ALT"] == 17.0
            assert await client.params.get_param_int("MAV_TYPE") == 2
            everything = await client.params.get_all_params()
            assert {"NAV_ACC_RAD", "MPC_XY_VEL_MAX"} <= {parameter.name for parameter in everything.float_params}
        await until(lambda: all(client.last("MISSION_CURRENT").get("total") == 3 for client in clients))
        ids = {client.last("MISSION_CURRENT")["mission_id"] for client in clients}
        assert ids == {vehicle.mission.mission_id for vehicle in fleet.vehicles.values()}
        await clients[0].missions.clear_mission()
        assert len(clients[0].truth.mission) == 0


@pytest.mark.e2e
async def test_mavsdk_sees_a_healthy_px4_that_stands_at_home(free_port: int) -> None:
    async with clients_of(1, 10.0, free_port) as (_, (client,)):
        home = await first(client.telemetry.subscribe_home())
        assert (home.latitude_deg, home.longitude_deg) == pytest.approx(HOME, abs=1e-6)
        async with asyncio.timeout(5.0):
            async with aclosing(client.telemetry.subscribe_health_all_ok()) as healthy:
                async for well in healthy:
                    if well:
                        break


@pytest.mark.e2e
async def test_three_vehicles_fly_a_whole_operation_under_mavsdk(free_port: int) -> None:
    async with clients_of(3, 10.0, free_port) as (fleet, clients):
        await asyncio.gather(*(take_off(client) for client in clients))
        await asyncio.gather(*(fly_pause_and_swap(client) for client in clients))
        await asyncio.gather(come_home(clients[0]), land_here(clients[1]), be_killed(fleet, clients[2]))


async def take_off(client: Client) -> None:
    await client.action.set_takeoff_altitude(20.0)
    await client.action.arm()
    await client.action.takeoff()
    await until(lambda: client.last("GLOBAL_POSITION_INT").get("relative_alt", 0) > 19_500)
    assert client.truth.position[2] > 19.4


async def fly_pause_and_swap(client: Client) -> None:
    items = [speed(0, 4.0, current=1), waypoint(client, 1, 20.0, 0.0), waypoint(client, 2, 150.0, 0.0)]
    await upload_and_compare(client, items)
    await client.missions.set_current_mission_item(0)
    await client.missions.start_mission()
    await until(lambda: client.last("MISSION_CURRENT").get("seq") == 2)
    await until(lambda: [message["seq"] for message in client.seen.get("MISSION_ITEM_REACHED", [])] == [0, 1])
    progress = await client.missions.mission_progress()
    assert (progress.current, progress.total) == (2, 3)
    await client.missions.pause_mission()
    await until(lambda: client.truth.autopilot.body.ground_speed_mps < 0.1)
    await until(lambda: client.last("HEARTBEAT")["custom_mode"] == PX4.custom_modes[Mode.HOLD])
    await client.missions.start_mission()
    await until(lambda: client.truth.autopilot.body.ground_speed_mps > 3.9)
    before = client.truth.mission.mission_id
    await upload_and_compare(client, [waypoint(client, 0, 30.0, 60.0, current=1), speed(1, 8.0)])
    await client.missions.set_current_mission_item(0)
    await until(lambda: client.last("MISSION_CURRENT").get("mission_id") not in (None, before))
    assert client.truth.mode is Mode.MISSION
    await until(lambda: client.truth.mode is Mode.HOLD)
    assert client.truth.autopilot.body.distance_to(60.0, 30.0) < 3.0
    async with asyncio.timeout(5.0):
        while not await client.missions.is_mission_finished():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def come_home(client: Client) -> None:
    await client.action.return_to_launch()
    await until(lambda: not client.truth.armed)
    assert client.truth.autopilot.body.distance_to(0.0, 0.0) < 0.1


async def land_here(client: Client) -> None:
    await client.action.land()
    await until(lambda: not client.truth.armed)
    assert client.truth.autopilot.body.distance_to(60.0, 30.0) < 5.0


async def be_killed(fleet: Fleet, client: Client) -> None:
    fleet.inject(Kill(client.truth.system_id))
    await asyncio.sleep(0.2)
    client.seen.clear()
    await asyncio.sleep(1.0)
    assert client.seen == {}
    assert client.truth.autopilot.crashed
