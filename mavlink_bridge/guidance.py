"""Guidance while a plan is flown: the schedule keeper over missions, or a stream of setpoints. All in fleet time.

`keep` looks at each vehicle ten times a fleet second and gives the keeper's orders. `Stream` sends setpoints; when it
ends, for whatever reason, the vehicles go on from the mission that is on board or hold, by policy. If this whole
process dies, PX4 holds after COM_OF_LOSS_T (COM_OBL_RC_ACT) and ArduCopter after GUID_TIMEOUT, which is why the
preflight audit insists on them; `guard` then says the rest.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from mavsdk.plugins.mavlink_direct import MavlinkDirectError

from mavlink_bridge import departure, flight
from mavlink_bridge.autopilots import STREAM_MODE, FlightMode
from mavlink_bridge.geodesy import geodetic_to_east_north
from mavlink_bridge.items import Mission
from mavlink_bridge.keeper import Keeper, Order, Slip
from mavlink_bridge.stream import RATE_HZ, Streamer
from mavlink_bridge.vehicle import NotDone, Vehicle
from planner.scenario import Origin

LOOK_S = 0.1
"""Fleet seconds between two looks of the keeper."""
SHORTEST_SLEEP_S = 0.005
"""Wall seconds; a fleet that lives much faster than we do is looked at less often."""
FRESH_S = 2.0
"""A position older than this (fleet seconds) is not steered by."""
PREPARE_S = 1.2
"""Fleet seconds of setpoints before the mode is changed: PX4 refuses OFFBOARD without."""


class FallBack(StrEnum):
    """What vehicles do when their stream of setpoints ends before the plan does."""

    MISSION = "mission"
    """Go on from the mission on board, at the waypoint of the slot that lasts."""
    HOLD = "hold"


@dataclass(frozen=True, kw_only=True)
class Kept:
    """One vehicle under a keeper; `origin` is where its plan's (0, 0) lies."""

    vehicle: Vehicle
    keeper: Keeper
    origin: Origin


OnSlip = Callable[[int, Slip], None]
OnOrder = Callable[[int, Order], None]


async def keep(
    kept: Mapping[int, Kept],
    *,
    elapsed_s: Callable[[], float],
    now_s: Callable[[], float],
    scale: float,
    on_slip: OnSlip,
    on_order: OnOrder = lambda _system_id, _order: None,
) -> None:
    """Keep vehicles on schedule until cancelled.

    elapsed_s: fleet seconds since slot 0 of their plans. now_s: the fleet's clock. scale: fleet seconds a wall second.
    on_slip(system_id, slip): once for each vehicle and slot; on_order: for each command given.
    """
    giving: dict[int, asyncio.Task[None]] = {}
    try:
        while True:
            for system_id, one in kept.items():
                order = _look(one, system_id, elapsed_s(), now_s(), on_slip)
                if order is not None and (system_id not in giving or giving[system_id].done()):
                    on_order(system_id, order)
                    giving[system_id] = asyncio.create_task(_give(one.vehicle, order))
            await asyncio.sleep(max(LOOK_S / scale, SHORTEST_SLEEP_S))
    finally:
        for task in giving.values():
            task.cancel()
        await asyncio.gather(*giving.values(), return_exceptions=True)


def _look(one: Kept, system_id: int, elapsed_s: float, now_s: float, on_slip: OnSlip) -> Order | None:
    said = one.vehicle.state.snapshot()
    if said is None or said.place_deg is None or now_s - said.heard_at_s > FRESH_S:
        return None
    age_s = now_s - said.heard_at_s
    velocity = (said.velocity_east_mps, said.velocity_north_mps)
    east, north = geodetic_to_east_north(one.origin, *said.place_deg)
    point = (east + velocity[0] * age_s, north + velocity[1] * age_s)
    slip = one.keeper.slip(elapsed_s, point)
    if slip is not None:
        on_slip(system_id, slip)
    if said.mode is not FlightMode.MISSION or said.mission_current is None:
        return None
    return one.keeper.advise(elapsed_s, point, velocity, said.mission_current)


async def _give(vehicle: Vehicle, order: Order) -> None:
    """An order that is not taken is given again by the next look."""
    try:
        if order.item is not None:
            await flight.set_current(vehicle, order.item)
        elif order.speed_mps is not None:
            await flight.change_speed(vehicle, order.speed_mps)
    except NotDone:
        return


@dataclass(frozen=True, kw_only=True)
class Streamed:
    """One vehicle guided by setpoints, with the mission it falls back on."""

    vehicle: Vehicle
    streamer: Streamer
    mission: Mission


class Stream:
    """Setpoints for several vehicles. `begin` puts them into the mode, `run` guides them until the plan or we end.

    `elapsed_s()` is fleet seconds since slot 0 began, and negative before. `scale`: fleet seconds a wall second.
    """

    def __init__(self, streamed: Mapping[int, Streamed], *, scale: float, fall_back: FallBack) -> None:
        self._streamed = dict(streamed)
        self._scale = scale
        self._fall_back = fall_back

    async def begin(self) -> dict[int, str | None]:
        """Stream the first points, change the mode; for each vehicle what went wrong, or None."""
        until = asyncio.get_running_loop().time() + max(PREPARE_S / self._scale, 0.2)
        while asyncio.get_running_loop().time() < until:
            self._send(-1.0)
            await self._pause()
        changing = {
            system_id: asyncio.create_task(_mode_error(one.vehicle)) for system_id, one in self._streamed.items()
        }
        while not all(task.done() for task in changing.values()):
            self._send(-1.0)
            await self._pause()
        return {system_id: task.result() for system_id, task in changing.items()}

    async def run(self, elapsed_s: Callable[[], float]) -> None:
        """Guide until the last slot begins, then hover there. However it ends, nobody is left without guidance."""
        slot_s, last = next((one.streamer.route.slot_s, one.streamer.route.last) for one in self._streamed.values())
        try:
            while elapsed_s() < (last + 1) * slot_s:
                self._send(elapsed_s())
                await self._pause()
        finally:
            await asyncio.shield(self._hand_over(elapsed_s(), slot_s, last))

    def leave(self, system_id: int) -> None:
        """Send it nothing any more, and leave its mode to whoever flies it now."""
        self._streamed.pop(system_id, None)

    async def _hand_over(self, elapsed_s: float, slot_s: float, last: int) -> None:
        slot = next_slot(elapsed_s, slot_s, last)
        await asyncio.gather(
            *(let_go(one.vehicle, one.mission.item_of_slot(slot), self._fall_back) for one in self._streamed.values())
        )

    def _send(self, elapsed_s: float) -> None:
        for one in list(self._streamed.values()):
            try:
                one.vehicle.send(one.streamer.setpoint(elapsed_s, one.vehicle.state.boot_ms or 0))
            except MavlinkDirectError:
                continue

    async def _pause(self) -> None:
        await asyncio.sleep(max(1 / RATE_HZ / self._scale, SHORTEST_SLEEP_S))


def next_slot(elapsed_s: float, slot_s: float, last: int) -> int:
    """The slot whose waypoint is flown to when missions take over: the one that begins next, at most the last."""
    return min(max(int(elapsed_s // slot_s) + 1, 0), last)


async def let_go(vehicle: Vehicle, item: int, fall_back: FallBack) -> str | None:
    """Fly the mission on board from `item` on, or hold (by policy, or because it will not fly it); what went wrong.

    One that somebody else flies is left to them. One that hovers because its setpoints came late (PX4 leaves OFFBOARD
    then) is still ours.
    """
    if not flight.is_ours(vehicle):
        return flight.not_ours(vehicle)
    if fall_back is FallBack.HOLD:
        return await flight.error_of(flight.hold(vehicle))
    error = await flight.error_of(_fly_from(vehicle, item))
    if error is not None:
        await flight.error_of(flight.hold(vehicle))
    return error


async def _fly_from(vehicle: Vehicle, item: int) -> None:
    await flight.set_current(vehicle, item)
    await departure.start(vehicle, item)


async def _mode_error(vehicle: Vehicle) -> str | None:
    if vehicle.state.autopilot is None:
        return "its autopilot is neither PX4 nor ArduPilot"
    return await flight.error_of(flight.set_mode(vehicle, STREAM_MODE[vehicle.autopilot]))
