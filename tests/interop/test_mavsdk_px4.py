"""A PX4 fleet against MAVSDK's asyncio API on loopback UDP"""

import asyncio
import json
from contextlib import aclosing, suppress
from typing import TYPE_CHECKING, Any

import pytest
from mavsdk.asyncio.plugins.component_metadata import ComponentMetadataAsync
from mavsdk.asyncio.plugins.failure import FailureAsync
from mavsdk.plugins.component_metadata.component_metadata import ComponentMetadataError, MetadataType
from mavsdk.plugins.failure.failure import FailureError, FailureType, FailureUnit

from skyfolio.sim import Fleet, Kill, Mode
from skyfolio.sim.flavours import PX4

if TYPE_CHECKING:
    from tests.interop.conftest import Client, OpenClients, Until

HOME = (47.397742, 8.545594)


async def first(stream: Any) -> Any:
    """Return the first value of a subscription."""
    async with aclosing(stream), asyncio.timeout(60.0):
        return await anext(stream)


@pytest.mark.parametrize("one_port", [True, False], ids=["one port", "a port each"])
async def test_mavsdk_finds_eight_vehicles_and_moves_missions_and_parameters(
    clients_of: "OpenClients", until: "Until", one_port: bool
) -> None:
    async with clients_of(8, one_port=one_port) as (fleet, clients):
        for client in clients:
            items = [
                client.speed(0, 4.5, current=1),
                client.waypoint(1, 10.0, 5.0, param1=3.0),
                client.waypoint(2, 20.0, 0.0),
            ]
            await client.upload_and_compare(items)
            await client.action.set_takeoff_altitude(17.0)
            assert client.truth.autopilot.parameters["MIS_TAKEOFF_ALT"] == 17.0
        assert await clients[3].params.get_param_int("MAV_TYPE") == 2
        everything = await clients[7].params.get_all_params()
        assert {"NAV_ACC_RAD", "MPC_XY_VEL_MAX"} <= {parameter.name for parameter in everything.float_params}
        await until(lambda: all(client.last("MISSION_CURRENT").get("total") == 3 for client in clients))
        ids = {client.last("MISSION_CURRENT")["mission_id"] for client in clients}
        assert ids == {vehicle.mission.mission_id for vehicle in fleet.vehicles.values()}
        await clients[0].missions.clear_mission()
        assert len(clients[0].truth.mission) == 0


@pytest.mark.e2e
async def test_mavsdk_sees_a_healthy_px4_that_stands_at_home(clients_of: "OpenClients") -> None:
    async with clients_of(1) as (_, (client,)):
        home = await first(client.telemetry.subscribe_home())
        assert (home.latitude_deg, home.longitude_deg) == pytest.approx(HOME, abs=1e-6)
        battery = await first(client.telemetry.subscribe_battery())
        assert battery.remaining_percent == pytest.approx(100.0, abs=2.0)
        async with asyncio.timeout(60.0):
            async with aclosing(client.telemetry.subscribe_health_all_ok()) as healthy:
                async for well in healthy:
                    if well:
                        break


@pytest.mark.e2e
async def test_mavsdk_moves_fences_and_rally_points_beside_a_mission(clients_of: "OpenClients") -> None:
    async with clients_of(1) as (_, (client,)):
        corners = [(-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0)]
        fence = [
            client.waypoint(seq, *corner, command=5001, frame=0, param1=4.0, param4=0.0, z=0.0, mission_type=1)
            for seq, corner in enumerate(corners)
        ]
        rally = [client.waypoint(0, 30.0, 0.0, command=5100, frame=3, param4=0.0, mission_type=2)]
        await client.missions.upload_geofence(fence)
        await client.missions.upload_rally_points(rally)
        assert [item.x for item in await client.missions.download_geofence()] == [item.x for item in fence]
        assert [item.x for item in await client.missions.download_rallypoints()] == [item.x for item in rally]
        assert await client.missions.download_mission() == []


@pytest.mark.e2e
async def test_mavsdk_injects_failures_once_they_are_enabled(clients_of: "OpenClients", until: "Until") -> None:
    async with clients_of(1) as (_, (client,)):
        with pytest.raises(FailureError):
            await client.failure.inject(FailureUnit.SENSOR_GPS, FailureType.OFF, 0)
        await client.params.set_param_int("SYS_FAILURE_EN", 1)
        enabled = FailureAsync(client.system)  # it reads SYS_FAILURE_EN once, when it is made
        await enabled.inject(FailureUnit.SENSOR_GPS, FailureType.OFF, 0)
        await until(lambda: not client.truth.autopilot.satellites)
        await enabled.inject(FailureUnit.SENSOR_GPS, FailureType.OK, 0)
        await until(lambda: client.truth.autopilot.satellites)
        with pytest.raises(FailureError):
            await enabled.inject(FailureUnit.SENSOR_VIO, FailureType.OFF, 0)


@pytest.mark.e2e
async def test_mavsdk_reads_the_description_of_the_parameters(clients_of: "OpenClients") -> None:
    async with clients_of(1) as (_, (client,)):
        metadata = ComponentMetadataAsync(client.system)
        await metadata.request_autopilot_component()
        text = ""
        async with asyncio.timeout(60.0):
            while not text:
                with suppress(ComponentMetadataError):
                    text = (await metadata.get_metadata(1, MetadataType.PARAMETER)).json_metadata
                await asyncio.sleep(0.05)
        described = {parameter["name"]: parameter for parameter in json.loads(text)["parameters"]}
        assert described["NAV_ACC_RAD"]["default"] == 2.0


@pytest.mark.e2e
async def test_three_vehicles_fly_a_whole_operation_under_mavsdk(clients_of: "OpenClients", until: "Until") -> None:
    async with clients_of(3) as (fleet, clients):
        await asyncio.gather(*(take_off(client, until) for client in clients))
        await asyncio.gather(*(fly_pause_and_swap(client, until) for client in clients))
        await asyncio.gather(
            come_home(clients[0], until), land_here(clients[1], until), be_killed(fleet, clients[2], until)
        )


async def take_off(client: "Client", until: "Until") -> None:
    await client.action.set_takeoff_altitude(20.0)
    await client.action.arm()
    await client.action.takeoff()
    await until(lambda: client.last("GLOBAL_POSITION_INT").get("relative_alt", 0) > 19_500)
    assert client.truth.position[2] > 19.4


async def fly_pause_and_swap(client: "Client", until: "Until") -> None:
    await client.upload_and_compare(
        [client.speed(0, 4.0, current=1), client.waypoint(1, 20.0, 0.0), client.waypoint(2, 150.0, 0.0)]
    )
    await client.missions.set_current_mission_item(0)
    await client.missions.start_mission()
    await until(lambda: client.last("MISSION_CURRENT").get("seq") == 2)
    await until(lambda: {message["seq"] for message in client.seen.get("MISSION_ITEM_REACHED", [])} == {0, 1})
    progress = await client.missions.mission_progress()
    assert (progress.current, progress.total) == (2, 3)
    await client.missions.pause_mission()
    await until(lambda: client.truth.autopilot.body.ground_speed_mps < 0.1)
    await until(lambda: client.last("HEARTBEAT")["custom_mode"] == PX4.custom_modes[Mode.HOLD])
    await client.missions.start_mission()
    await until(lambda: client.truth.autopilot.body.ground_speed_mps > 3.9)
    before = client.truth.mission.mission_id
    await client.upload_and_compare([client.waypoint(0, 30.0, 60.0, current=1), client.speed(1, 8.0)])
    await client.missions.set_current_mission_item(0)
    await until(lambda: client.last("MISSION_CURRENT").get("mission_id") not in (None, before))
    assert client.truth.mode.name == "MISSION"
    await until(lambda: client.truth.mode is Mode.HOLD)
    assert client.truth.autopilot.body.distance_to(60.0, 30.0) < 3.0
    async with asyncio.timeout(60.0):
        while not await client.missions.is_mission_finished():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def come_home(client: "Client", until: "Until") -> None:
    await client.action.return_to_launch()
    await until(lambda: not client.truth.armed)
    assert client.truth.autopilot.body.distance_to(0.0, 0.0) < 0.1


async def land_here(client: "Client", until: "Until") -> None:
    await client.action.land()
    await until(lambda: not client.truth.armed)
    assert client.truth.autopilot.body.distance_to(60.0, 30.0) < 5.0


async def be_killed(fleet: Fleet, client: "Client", until: "Until") -> None:
    fleet.inject(Kill(client.truth.system_id))
    await asyncio.sleep(0.2)
    client.seen.clear()
    await until(lambda: client.truth.autopilot.dynamics.crashed)
    await asyncio.sleep(1.0)
    assert client.seen == {}
