"""Speed orders: never to a vehicle that is not in its mission at this moment, and taken back from one that left it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from skyfolio.mavlink_bridge import Autopilot, FlightMode, compile_mission
from skyfolio.mavlink_bridge.keeper import Keeper
from skyfolio.mavlink_bridge.keeping import Kept, keep
from skyfolio.mavlink_bridge.px4 import PX4_MODEL as PX4
from skyfolio.mavlink_bridge.speeds import SpeedRestored, SpeedWatch, order_speed, restore_speed
from skyfolio.mavlink_bridge.telemetry import TelemetryState
from skyfolio.mavlink_bridge.vehicle import NotDone
from skyfolio.planner.plans import Plan

PlanOf = Callable[..., Plan]
MISSION, RETURN = 0x04040000, 0x05040000
"""PX4's HEARTBEAT.custom_mode."""
CRUISE_MPS = 5.0


class OneVehicle:
    """A PX4 as the bridge sees it: its HEARTBEAT shows `mode` once a second, and when it is asked for."""

    def __init__(self, mode: int = MISSION) -> None:
        self.system_id, self.autopilot = 7, Autopilot.PX4
        self.state = TelemetryState(7)
        self.flies_our_speed = False
        self.mode, self.answers_requests = mode, True
        self.speeds_mps: list[float] = []
        self.at_speed_order: Callable[[], None] = lambda: None
        self.on_heartbeat: Callable[[], None] = lambda: None
        self.refuses = 0
        self.heartbeat()

    def heartbeat(self) -> None:
        self.state.fold("HEARTBEAT", {"type": 2, "autopilot": 12, "custom_mode": self.mode, "base_mode": 128}, 0.0)
        self.on_heartbeat()

    async def command(self, number: int, *params: float | None) -> None:
        await asyncio.sleep(0)
        if number == 512 and params[0] == 0.0 and self.answers_requests:
            self.heartbeat()
        if number == 178:
            assert params[1] is not None
            if self.refuses:
                self.refuses -= 1
                raise NotDone("change speed: TIMEOUT")
            self.speeds_mps.append(params[1])
            self.at_speed_order()

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        del timeout_s
        await asyncio.sleep(0)
        return condition()


def watched(vehicle: OneVehicle) -> list[SpeedRestored]:
    """Have it watched, as the link does with every HEARTBEAT; what was restored."""
    told: list[SpeedRestored] = []
    watch = SpeedWatch(lambda _system_id: CRUISE_MPS)
    watch.tell = told.append
    vehicle.on_heartbeat = lambda: watch.look(vehicle)  # type: ignore[arg-type]
    return told


async def settled() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


async def test_no_speed_is_ordered_on_an_old_heartbeats_word() -> None:
    vehicle: Any = OneVehicle()
    assert vehicle.state.mode is FlightMode.MISSION
    vehicle.mode = RETURN  # its failsafe has acted; the next HEARTBEAT of its own is half a second away
    with pytest.raises(NotDone, match="not in its mission"):
        await order_speed(vehicle, 0.59)
    assert vehicle.speeds_mps == []


async def test_no_speed_is_ordered_without_a_heartbeat() -> None:
    vehicle: Any = OneVehicle()
    vehicle.answers_requests = False
    with pytest.raises(NotDone, match="no heartbeat"):
        await order_speed(vehicle, 0.59)
    assert vehicle.speeds_mps == []


async def test_a_vehicle_that_left_its_mission_as_the_order_came_gets_its_own_speed_back_at_once() -> None:
    vehicle: Any = OneVehicle()
    told = watched(vehicle)

    def failsafe() -> None:
        vehicle.mode = RETURN

    vehicle.at_speed_order = failsafe
    await order_speed(vehicle, 0.59)
    await settled()
    assert vehicle.speeds_mps == [0.59, CRUISE_MPS]  # without another HEARTBEAT of its own
    assert not vehicle.flies_our_speed
    assert told == [SpeedRestored(system_id=7, mode=FlightMode.RETURN, speed_mps=CRUISE_MPS)]


@pytest.mark.parametrize("mode", [RETURN, 0x06040000, 0x00030000], ids=["return", "land", "position"])
async def test_whoever_leaves_our_modes_later_flies_on_at_its_own_speed(mode: int) -> None:
    vehicle: Any = OneVehicle()
    watched(vehicle)
    await order_speed(vehicle, 2.0)
    vehicle.heartbeat()
    await settled()
    assert vehicle.speeds_mps == [2.0]
    vehicle.mode = mode
    vehicle.heartbeat()
    vehicle.heartbeat()
    await settled()
    assert vehicle.speeds_mps == [2.0, CRUISE_MPS]  # once


async def test_one_that_was_never_ordered_a_speed_is_left_alone_when_it_returns() -> None:
    vehicle: Any = OneVehicle()
    told = watched(vehicle)
    vehicle.mode = RETURN
    vehicle.heartbeat()
    await settled()
    assert (vehicle.speeds_mps, told) == ([], [])


async def test_a_restored_speed_that_is_not_acknowledged_is_sent_again() -> None:
    vehicle: Any = OneVehicle()
    told = watched(vehicle)
    await order_speed(vehicle, 2.0)
    vehicle.mode, vehicle.refuses = RETURN, 2
    vehicle.heartbeat()
    await settled()
    assert vehicle.speeds_mps == [2.0, CRUISE_MPS]
    assert told[0].error is None


async def test_an_order_nobody_waits_for_any_more_may_have_arrived_all_the_same() -> None:
    vehicle: Any = OneVehicle()
    vehicle.refuses = 1
    with pytest.raises(NotDone):
        await order_speed(vehicle, 2.0)
    assert vehicle.flies_our_speed
    await restore_speed(vehicle, CRUISE_MPS)
    assert not vehicle.flies_our_speed


async def test_the_keeper_sends_nothing_to_a_vehicle_whose_last_heartbeat_is_outdated(plan_of: PlanOf) -> None:
    path = [(0.0, 0.0), (0.0, 20.0), (0.0, 40.0)]
    mission = compile_mission(plan_of({"uav-1": path}), "uav-1")
    vehicle: Any = OneVehicle()
    place = {"lat": 473977420, "lon": 85455940, "relative_alt": 60_000, "alt": 548_000, "vx": 0, "vy": 0, "vz": 0}
    vehicle.state.fold("GLOBAL_POSITION_INT", {**place, "time_boot_ms": 1}, 0.0)
    vehicle.state.fold("MISSION_CURRENT", {"seq": mission.start_item}, 0.0)
    vehicle.mode = RETURN
    origin = plan_of({"uav-1": path}).scenario.origin
    kept = Kept(vehicle=vehicle, keeper=Keeper(path, 5.0, mission, PX4), origin=origin)
    orders: list[Any] = []
    keeping = asyncio.create_task(
        keep(
            {7: kept},
            elapsed_s=lambda: 2.0,
            now_s=lambda: 0.0,
            scale=100.0,
            on_slip=lambda *_: None,
            on_order=lambda _system, order: orders.append(order),
        )
    )
    async with asyncio.timeout(60):
        while not orders:  # noqa: ASYNC110
            await asyncio.sleep(0.005)
    await settled()
    keeping.cancel()
    await asyncio.gather(keeping, return_exceptions=True)
    assert orders[0].speed_mps is not None
    assert vehicle.speeds_mps == []
