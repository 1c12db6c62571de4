"""What the link makes of vehicles that fail, on sockets: reboots, clock jumps, humans, foreign stations, ghosts."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge import Autopilot, compile_mission
from skyfolio.mavlink_bridge.conditions import Condition
from skyfolio.planner.plans import Plan
from skyfolio.sim import Kill
from skyfolio.sim.faults import ClockJump, ModeChange, Reboot
from tests.virtual_time import in_virtual_time

Open = Callable[..., Any]
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


async def flying(field: Any, plan: Plan, autopilot: Autopilot) -> None:
    """In slot 0, the classifier watching."""
    missions = {
        n: compile_mission(plan, uav, autopilot=autopilot) for n, uav in enumerate(plan.trajectories_m, start=1)
    }
    assert all(result.verified for result in (await field.link.upload(missions)).values())
    await field.link.launch(dict.fromkeys(missions, plan.scenario.altitude_m), timeout_s=30)
    started = await field.link.start(missions)
    assert all(result.ok for result in started.values()), started


async def conditions(field: Any, seconds: float) -> list[Condition]:
    """Everything vehicle 1 goes through meanwhile."""
    found: list[Condition] = []

    async def listen() -> None:
        async for change in field.link.changes():
            if change.system_id == 1 and change.condition is not None:
                found.append(change.condition.after)  # noqa: PERF401

    listening = asyncio.create_task(listen())
    await field.fly_for(seconds)
    listening.cancel()
    await asyncio.gather(listening, return_exceptions=True)
    return found


@pytest.fixture
def low(line_and_hover: Plan) -> Plan:
    return line_and_hover.model_copy(update={"scenario": line_and_hover.scenario.with_changes(altitude_m=8.0)})


@BOTH
@in_virtual_time
async def test_a_human_who_takes_over_is_seen_and_nothing_else_is(
    airfield: Open, low: Plan, autopilot: Autopilot
) -> None:
    async with airfield(low, autopilot=autopilot, speedup=5.0) as field:
        await flying(field, low, autopilot)
        field.fleet.inject(ModeChange(1, "POSITION"))
        assert await conditions(field, 5.0) == [Condition.HUMAN]


@in_virtual_time
async def test_a_reboot_on_the_ground_is_seen_and_passes(airfield: Open, low: Plan) -> None:
    async with airfield(low, speedup=5.0) as field:
        await field.fly_for(10.0)
        watching = asyncio.create_task(conditions(field, 30.0))
        field.fleet.inject(Reboot(1, for_s=2.0))
        found = await watching
        assert Condition.REBOOTED in found
        assert found[-1] is Condition.LIVE


@in_virtual_time
async def test_a_vehicle_whose_clock_jumps_is_neither_lost_nor_rebooted(airfield: Open, low: Plan) -> None:
    async with airfield(low, speedup=5.0) as field:
        await field.fly_for(10.0)
        field.fleet.inject(ClockJump(1, 30.0))
        assert await conditions(field, 8.0) == []


@pytest.mark.e2e
async def test_a_ghost_with_a_living_companion_is_a_silent_autopilot(airfield: Open, low: Plan, free_port: int) -> None:
    async with airfield(low, speedup=5.0, port=free_port) as field:
        await field.fly_for(2.0)
        companion = dialect.MAVLink(None, srcSystem=1, srcComponent=191)
        beat = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=("127.0.0.1", free_port)
        )
        watching = asyncio.create_task(conditions(field, 25.0))
        field.fleet.inject(Kill(1))
        while not watching.done():
            transport.sendto(beat.pack(companion))
            await asyncio.sleep(0.1)
        transport.close()
        assert Condition.AUTOPILOT_SILENT in await watching


@pytest.mark.e2e
@BOTH
async def test_a_foreign_station_that_transfers_too_does_not_harm_an_upload(
    airfield: Open, low: Plan, autopilot: Autopilot
) -> None:
    async with airfield(low, autopilot=autopilot, speedup=5.0) as field:
        station = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        loop = asyncio.get_running_loop()
        address = field.fleet.vehicles[1].link._transport.get_extra_info("sockname")
        transport, _ = await loop.create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=("127.0.0.1", address[1])
        )
        mission = compile_mission(low, "uav-1", autopilot=autopilot)
        uploading = asyncio.create_task(field.link.upload({1: mission}, attempts=6))
        while not uploading.done():
            transport.sendto(dialect.MAVLink_mission_request_list_message(1, 1).pack(station))
            transport.sendto(dialect.MAVLink_mission_request_int_message(1, 1, 0).pack(station))
            await asyncio.sleep(0.05)
        transport.close()
        (result,) = (await uploading).values()
        assert result.verified, result.error
