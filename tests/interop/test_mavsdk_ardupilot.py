"""An ArduCopter fleet against MAVSDK's asyncio API on loopback UDP"""

import asyncio
from contextlib import aclosing
from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim import Mode

if TYPE_CHECKING:
    from tests.interop.conftest import Client, OpenClients, Until


def a_mission(client: "Client", *legs: Any) -> list[Any]:
    """Return home, a take-off to 20 m, then the legs."""
    home = client.waypoint(0, 0.0, 0.0, current=1, z=0.0)
    return [home, client.waypoint(1, 0.0, 0.0, command=22, param4=0.0), *legs]


async def test_missions_are_read_back_as_an_arducopter_keeps_them(clients_of: "OpenClients") -> None:
    async with clients_of(1, autopilot="ardupilot") as (_, (client,)):
        sent = a_mission(client, client.speed(2, 4.5), client.waypoint(3, 20.0, 0.0, param1=2.6, param2=1.0))
        await client.missions.upload_mission(sent)
        got = await client.missions.download_mission()
        assert [(item.command, item.x, item.y) for item in got[1:]] == [(i.command, i.x, i.y) for i in sent[1:]]
        assert (got[0].frame, got[0].z) == (0, 488.0)
        assert (got[3].frame, got[3].param1, got[3].param2) == (3, 2.0, 0.0)
        assert got[2].param2 == 4.5


@pytest.mark.e2e
async def test_it_streams_no_position_until_a_rate_is_set(clients_of: "OpenClients") -> None:
    async with clients_of(1, speedup=1.0, autopilot="ardupilot") as (_, (client,)):
        stream = client.telemetry.subscribe_position()
        async with aclosing(stream):
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.5):
                    await anext(stream)
        await client.telemetry.set_rate_position(5.0)
        async with aclosing(client.telemetry.subscribe_position()) as positions, asyncio.timeout(60.0):
            position = await anext(positions)
        assert position.latitude_deg == pytest.approx(47.397742, abs=1e-6)


@pytest.mark.e2e
async def test_a_flight_from_the_ground_with_a_swap_a_pause_and_a_return(
    clients_of: "OpenClients", until: "Until"
) -> None:
    async with clients_of(2, autopilot="ardupilot") as (_, clients):
        await asyncio.gather(*(fly(client, until) for client in clients))


async def fly(client: "Client", until: "Until") -> None:
    truth = client.truth
    await client.params.set_param_int("AUTO_OPTIONS", 3)
    await client.missions.upload_mission(
        a_mission(client, client.speed(2, 5.0), client.waypoint(3, 60.0, 0.0), client.waypoint(4, 400.0, 0.0))
    )
    await client.action.arm()  # in AUTO MAVSDK would change to BRAKE first, in which it cannot be armed
    await client.missions.start_mission()
    await until(lambda: truth.autopilot.runner.index == 4)
    swap = a_mission(client, client.speed(2, 5.0), client.waypoint(3, 60.0, 300.0))
    await client.missions.upload_mission(swap)
    await client.missions.set_current_mission_item(2)
    await until(lambda: truth.autopilot.body.east_m > 40.0)
    await client.missions.pause_mission()
    await until(lambda: truth.autopilot.body.ground_speed_mps < 0.1)
    assert truth.mode.name == "BRAKE"
    await client.missions.start_mission()
    await until(lambda: truth.autopilot.body.ground_speed_mps > 2.0)
    await client.action.return_to_launch()
    await until(lambda: not truth.armed, 60.0)
    assert truth.autopilot.body.distance_to(0.0, 0.0) < 0.5


@pytest.mark.e2e
async def test_an_action_takes_off_in_guided_and_lands(clients_of: "OpenClients", until: "Until") -> None:
    async with clients_of(1, autopilot="ardupilot") as (_, (client,)):
        await client.action.set_takeoff_altitude(15.0)
        await client.action.arm()
        await client.action.takeoff()
        await until(lambda: client.truth.position[2] > 14.5)
        assert client.truth.mode is Mode.GUIDED
        await client.action.land()
        await until(lambda: not client.truth.armed)
