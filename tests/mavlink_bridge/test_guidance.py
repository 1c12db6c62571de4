"""Keeper and stream over the link, and what vehicles do when their stream ends."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Callable
from math import hypot
from pathlib import Path
from typing import Any

import pytest

from skyfolio.mavlink_bridge import Autopilot, compile_mission, east_north_to_geodetic, geodetic_to_east_north, guidance
from skyfolio.mavlink_bridge.altitudes import altitudes_of
from skyfolio.mavlink_bridge.guidance import FallBack, Stream, Streamed, let_go
from skyfolio.mavlink_bridge.keeper import Keeper, Order
from skyfolio.mavlink_bridge.keeping import Kept, keep
from skyfolio.mavlink_bridge.slip import Slip
from skyfolio.mavlink_bridge.stream import Streamer
from skyfolio.planner.plans import Plan
from skyfolio.sim import Fleet, Mode, ScaledClock
from tests.ports import free_port
from tests.virtual_time import in_virtual_time

Open = Callable[..., Any]
PlanOf = Callable[..., Plan]
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
PATH = [(0.0, 0.0), (0.0, 12.0), (0.0, 30.0), (0.0, 30.0), (10.0, 40.0), (25.0, 40.0)]
HOLD_ON_LOSS = 5
"""COM_OBL_RC_ACT; the default, 0, returns without a remote control."""
SERVICE = Path(__file__).with_name("streaming_service.py")


async def airborne(field: Any, plan: Plan, autopilot: Autopilot) -> Any:
    """At altitude with the mission on board."""
    mission = compile_mission(plan, "uav-1", autopilot=autopilot, model=field.link.model(1))
    (uploaded,) = (await field.link.upload({1: mission})).values()
    assert uploaded.verified, uploaded.error
    (launched,) = (await field.link.launch({1: plan.scenario.altitude_m}, timeout_s=30)).values()
    assert launched.ok, launched.error
    return mission


def distance_m(field: Any, plan: Plan, slot: int) -> float:
    lat, lon, _ = field.fleet.vehicles[1].position
    east, north = geodetic_to_east_north(plan.scenario.origin, lat, lon)
    planned = plan.trajectories_m["uav-1"][slot]
    return hypot(east - planned[0], north - planned[1])


def stream_of(field: Any, plan: Plan, mission: Any, fall_back: FallBack) -> Stream:
    streamer = Streamer(
        1,
        plan.trajectories_m["uav-1"],
        plan.scenario.slot_duration_s,
        altitudes_of(plan, "uav-1"),
        lambda point: east_north_to_geodetic(plan.scenario.origin, *point),
    )
    streamed = Streamed(vehicle=field.link.vehicle(1), streamer=streamer, mission=mission)
    return Stream({1: streamed}, scale=field.clock.speedup, fall_back=fall_back)


@BOTH
@in_virtual_time
async def test_the_keeper_gives_orders_and_tells_of_every_slot(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot
) -> None:
    plan = plan_of({"uav-1": PATH}, altitude_m=8.0)
    async with airfield(plan, autopilot=autopilot, speedup=5.0) as field:
        mission = await airborne(field, plan, autopilot)
        slips: list[Slip] = []
        orders: list[Order] = []
        keeper = Keeper(PATH, 5.0, mission, field.link.model(1))
        kept = Kept(vehicle=field.link.vehicle(1), keeper=keeper, origin=plan.scenario.origin)
        began = field.clock.now()
        await field.link.start({1})
        keeping = asyncio.create_task(
            keep(
                {1: kept},
                elapsed_s=lambda: field.clock.now() - began,
                now_s=field.clock.now,
                scale=5.0,
                on_slip=lambda _system, slip: slips.append(slip),
                on_order=lambda _system, order: orders.append(order),
            )
        )
        await field.fly_for(26.0)
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)
        assert [slip.slot for slip in slips] == [1, 2, 3, 4, 5]
        assert orders
        assert max(slip.distance_m for slip in slips) < 12.0  # at five times real time, on a loaded machine


class _GoesOn:
    """A keeper that has one item made current, again and again."""

    ends_s = 100.0

    def __init__(self, mission: Any) -> None:
        self.mission, self.refused = mission, 0

    def advise(self, *_seen: Any) -> Order:
        return Order(late_s=0.0, item=self.mission.start_item + 1)

    def slip(self, *_seen: Any) -> None:
        return None

    def not_taken(self, _order: Order) -> None:
        self.refused += 1


@BOTH
@pytest.mark.parametrize("sent", [False, True], ids=["the mission on board", "while another one is sent"])
@in_virtual_time
async def test_the_keeper_makes_an_item_current_only_in_the_mission_that_it_keeps(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot, sent: bool
) -> None:
    plan = plan_of({"uav-1": PATH}, altitude_m=8.0)
    async with airfield(plan, autopilot=autopilot, speedup=5.0) as field:
        keeper: Any = _GoesOn(await airborne(field, plan, autopilot))
        vehicle = field.link.vehicle(1)
        kept = Kept(vehicle=vehicle, keeper=keeper, origin=plan.scenario.origin)
        await field.link.start({1})
        before = len(items_set(field))
        vehicle.on_board = None if sent else vehicle.on_board
        keeping = asyncio.create_task(
            keep(
                {1: kept},
                elapsed_s=field.clock.now,
                now_s=field.clock.now,
                scale=5.0,
                on_slip=lambda _system, _slip: None,
            )
        )
        await field.fly_for(4.0)
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)
        assert (len(items_set(field)) == before) is sent
        assert keeper.refused or not sent


def items_set(field: Any) -> list[Any]:
    """Return the messages that have made an item of the vehicle's mission current."""
    received = [message for message in field.fleet.truth.messages if message.direction == "in"]
    return [message for message in received if message.name == "MISSION_SET_CURRENT" or message.command == 224]


@BOTH
@pytest.mark.parametrize("fall_back", list(FallBack))
@in_virtual_time
async def test_when_the_stream_ends_the_vehicle_goes_on_from_its_mission_or_holds(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot, fall_back: FallBack
) -> None:
    plan = plan_of({"uav-1": PATH}, altitude_m=8.0)
    async with airfield(plan, autopilot=autopilot, speedup=5.0) as field:
        mission = await airborne(field, plan, autopilot)
        stream = stream_of(field, plan, mission, fall_back)
        assert (await stream.begin()) == {1: None}
        began = field.clock.now()
        running = asyncio.create_task(stream.run(lambda: field.clock.now() - began))
        await field.fly_for(10.0)
        assert field.fleet.vehicles[1].autopilot.mode is Mode.GUIDED
        assert distance_m(field, plan, 2) < 6.0
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        holding = Mode.HOLD if autopilot is Autopilot.PX4 else Mode.GUIDED
        wanted = Mode.MISSION if fall_back is FallBack.MISSION else holding
        assert field.fleet.vehicles[1].autopilot.mode is wanted


@BOTH
@in_virtual_time
async def test_a_vehicle_gets_setpoints_until_it_flies_its_mission_however_late_the_command_arrives(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of({"uav-1": PATH}, altitude_m=8.0)
    async with airfield(plan, autopilot=autopilot) as field:
        mission = await airborne(field, plan, autopilot)
        stream = stream_of(field, plan, mission, FallBack.MISSION)
        await stream.begin()
        began, seen = field.clock.now(), list[Mode]()

        async def let_go_late(*arguments: Any) -> str | None:
            for _ in range(30):
                await field.fly_for(0.1)
                seen.append(field.fleet.vehicles[1].autopilot.mode)
            return await let_go(*arguments)

        monkeypatch.setattr(guidance, "let_go", let_go_late)
        running = asyncio.create_task(stream.run(lambda: field.clock.now() - began))
        await field.fly_for(10.0)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        assert set(seen) == {Mode.GUIDED}
        assert field.fleet.vehicles[1].autopilot.mode is Mode.MISSION


@BOTH
@in_virtual_time
async def test_a_vehicle_a_human_took_from_the_stream_is_left_to_the_human(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot
) -> None:
    plan = plan_of({"uav-1": PATH}, altitude_m=8.0)
    async with airfield(plan, autopilot=autopilot, speedup=5.0) as field:
        mission = await airborne(field, plan, autopilot)
        stream = stream_of(field, plan, mission, FallBack.MISSION)
        await stream.begin()
        began = field.clock.now()
        running = asyncio.create_task(stream.run(lambda: field.clock.now() - began))
        field.fleet.vehicles[1].autopilot.set_mode(Mode.POSITION)
        await field.fly_for(6.0)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        assert field.fleet.vehicles[1].autopilot.mode is Mode.POSITION


@pytest.mark.long
@pytest.mark.e2e
async def test_vehicles_whose_service_is_killed_go_on_from_their_mission_or_hold_by_policy() -> None:
    await asyncio.gather(*(stream_until_killed(autopilot) for autopilot in Autopilot))


async def stream_until_killed(autopilot: Autopilot) -> None:
    from tests.mavlink_bridge.conftest import specs_at  # noqa: PLC0415
    from tests.mavlink_bridge.streaming_service import PLAN  # noqa: PLC0415

    port = free_port(socket.SOCK_DGRAM)
    fleet = Fleet(specs_at(PLAN, autopilot), clock=ScaledClock(1.0), endpoint=f"udpout://127.0.0.1:{port}")
    async with fleet:
        goes_on, holds = (fleet.vehicles[number].autopilot for number in (1, 2))
        if autopilot is Autopilot.PX4:
            goes_on.parameters["COM_OBL_RC_ACT"] = holds.parameters["COM_OBL_RC_ACT"] = HOLD_ON_LOSS
        service = subprocess.Popen(  # noqa: ASYNC220
            [sys.executable, str(SERVICE), f"udpin://127.0.0.1:{port}", autopilot.value],
            cwd=Path(__file__).parents[2],
            env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": ""},
        )
        try:
            async with asyncio.timeout(90):
                while min(one.body.north_m if one.mode is Mode.GUIDED else 0.0 for one in (goes_on, holds)) < 10.0:  # noqa: ASYNC110
                    await asyncio.sleep(0.1)
        finally:
            service.kill()
            service.wait()
        killed_m = goes_on.body.north_m
        least_m, resting = killed_m, 0
        async with asyncio.timeout(120):
            while goes_on.body.north_m < killed_m + 40.0 or resting < 20:  # two seconds of rest
                least_m = min(least_m, goes_on.body.north_m)
                resting = resting + 1 if holds.body.ground_speed_mps < 0.3 else 0
                await asyncio.sleep(0.1)
        assert goes_on.mode is Mode.MISSION
        assert least_m > killed_m - 5.0, "the next waypoint, not one that was passed"
        stopped_m = holds.body.north_m
        await asyncio.sleep(3.0)
        assert abs(holds.body.north_m - stopped_m) < 1.0
        assert holds.mode is (Mode.HOLD if autopilot is Autopilot.PX4 else Mode.GUIDED)
        for one in (goes_on, holds):
            assert one.armed
            assert one.body.up_m > 6.0
