"""Guidance while a plan is flown: the schedule keeper over missions, or a stream of setpoints. All in fleet time.

`keep` looks at each vehicle ten times a fleet second and gives the keeper's orders. `Stream` sends setpoints; when it
ends, for whatever reason, the vehicles go on from the mission that is on board or hold, by policy. If this whole
process dies, PX4 holds after COM_OF_LOSS_T (COM_OBL_RC_ACT) and ArduCopter after GUID_TIMEOUT, which is why the
preflight audit insists on them; `guard` then says the rest.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from skyfolio.mavlink_bridge import departure, flight, speeds
from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.deviations import AltitudeWatch, Deviation, HomeWatch
from skyfolio.mavlink_bridge.geodesy import geodetic_to_east_north
from skyfolio.mavlink_bridge.items import Mission
from skyfolio.mavlink_bridge.keeper import Keeper, Order, Slip
from skyfolio.mavlink_bridge.stream import RATE_HZ, Streamer
from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle
from skyfolio.planner.scenario import Origin

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
    """One vehicle under a keeper; `origin` is where its plan's (0, 0) lies. `altitude`, `home`: what is watched."""

    vehicle: Vehicle
    keeper: Keeper
    origin: Origin
    altitude: AltitudeWatch | None = None
    home: HomeWatch | None = None


OnSlip = Callable[[int, Slip], None]
OnOrder = Callable[[int, Order], None]
OnDeviation = Callable[[int, Deviation], None]


async def keep(
    kept: Mapping[int, Kept],
    *,
    elapsed_s: Callable[[], float],
    now_s: Callable[[], float],
    scale: float,
    on_slip: OnSlip,
    on_order: OnOrder = lambda _system_id, _order: None,
    on_deviation: OnDeviation = lambda _system_id, _deviation: None,
) -> None:
    """Keep vehicles on schedule until cancelled.

    elapsed_s: fleet seconds since slot 0 of their plans. now_s: the fleet's clock. scale: fleet seconds a wall second.
    on_slip(system_id, slip): once for each vehicle and slot; on_order: for each command given; on_deviation: when its
    altitude or its home is not as planned.
    """
    giving: dict[int, asyncio.Task[None]] = {}
    try:
        while True:
            for system_id, one in kept.items():
                order, slip, deviations = _look(one, elapsed_s(), now_s())
                if slip is not None:
                    on_slip(system_id, slip)
                for deviation in deviations:
                    on_deviation(system_id, deviation)
                if order is None:
                    continue
                if system_id in giving and not giving[system_id].done():
                    one.keeper.not_taken(order)
                    continue
                on_order(system_id, order)
                giving[system_id] = asyncio.create_task(_give(one, order))
            await asyncio.sleep(max(LOOK_S / scale, SHORTEST_SLEEP_S))
    finally:
        for task in giving.values():
            task.cancel()
        await asyncio.gather(*giving.values(), return_exceptions=True)


def _look(one: Kept, elapsed_s: float, now_s: float) -> tuple[Order | None, Slip | None, list[Deviation]]:
    said = one.vehicle.state.snapshot()
    if said is None or said.place_deg is None or now_s - said.heard_at_s > FRESH_S:
        return None, None, []
    age_s = now_s - said.heard_at_s
    velocity = (said.velocity_east_mps, said.velocity_north_mps)
    east, north = geodetic_to_east_north(one.origin, *said.place_deg)
    point = (east + velocity[0] * age_s, north + velocity[1] * age_s)
    order = None
    if said.mode is FlightMode.MISSION and said.mission_current is not None:
        order = one.keeper.advise(elapsed_s, point, velocity, said.mission_current)
    return order, one.keeper.slip(elapsed_s, point), list(_deviations(one, said, elapsed_s))


def _deviations(one: Kept, said: Telemetry, elapsed_s: float) -> Iterator[Deviation]:
    """Altitude counts while the vehicle is ours and slots are flown, a home whenever it moves."""
    state = one.vehicle.state
    home = None if one.home is None else one.home.look(state.home_deg, state.home_amsl_m)
    if home is not None:
        yield home
    if one.altitude is not None and flight.is_ours(one.vehicle) and 0 <= elapsed_s < one.keeper.ends_s:
        altitude = one.altitude.look(elapsed_s, said.relative_alt_m)
        if altitude is not None:
            yield altitude


async def _give(one: Kept, order: Order) -> None:
    """Only to one that is seen in its mission just now. An order that is not taken is given again by a later look."""
    try:
        if order.item is not None:
            await speeds.require_in_mission(one.vehicle)
            await flight.set_current(one.vehicle, order.item)
        elif order.its_own_speed:
            await speeds.restore_speed(one.vehicle, order.speed_mps or one.keeper.model.cruise_mps)
        elif order.speed_mps is not None:
            await speeds.order_speed(one.vehicle, order.speed_mps)
    except NotDone:
        one.keeper.not_taken(order)


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
        route = next(iter(self._streamed.values())).streamer.route
        self._slot_s, self._last = route.slot_s, route.last
        self._scale = scale
        self._fall_back = fall_back
        self._ended = False
        self._handing: dict[int, asyncio.Task[str | None]] = {}

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
        last_s = (self._last + 1) * self._slot_s
        try:
            while not self._ended and elapsed_s() < last_s:
                self._send(elapsed_s())
                await self._pause()
        finally:
            handed_over = self.hand_over(elapsed_s())
            if handed_over:
                await asyncio.shield(asyncio.wait(handed_over.values()))

    def leave(self, system_id: int) -> None:
        """Send it nothing any more, and leave its mode to whoever flies it now, at once."""
        self._streamed.pop(system_id, None)
        if system_id in self._handing:
            self._handing[system_id].cancel()

    def hand_over(self, elapsed_s: float) -> Mapping[int, asyncio.Task[str | None]]:
        """No setpoints any more: let each go, once; the tasks that do it, by system id, each for itself."""
        if not self._ended:
            self._ended = True
            slot = next_slot(elapsed_s, self._slot_s, self._last)
            self._handing = {
                system_id: asyncio.create_task(
                    let_go(one.vehicle, one.mission.item_of_slot(slot), self._fall_back), name=f"let-go-{system_id}"
                )
                for system_id, one in self._streamed.items()
            }
        return self._handing

    def drop(self) -> None:
        """No setpoints any more and nothing in their place, at once: whoever calls this commands the vehicles now."""
        self._ended = True
        for task in self._handing.values():
            task.cancel()
        self._handing = {}

    def _send(self, elapsed_s: float) -> None:
        for one in list(self._streamed.values()):
            try:
                one.vehicle.send(one.streamer.setpoint(elapsed_s, one.vehicle.state.boot_ms or 0))
            except NotDone:
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
    return await flight.error_of(_enter_stream_mode(vehicle))


async def _enter_stream_mode(vehicle: Vehicle) -> None:
    await flight.set_mode(vehicle, vehicle.profile.stream_mode)
