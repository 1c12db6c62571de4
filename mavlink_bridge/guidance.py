"""Guide vehicles while a plan is flown: the schedule keeper over missions, or a stream of setpoints.

`keep` looks at each vehicle ten times a fleet second and sends the keeper's orders. `Stream` sends setpoints; when it
ends, for whatever reason, the vehicles fly the mission that is on board or hold, by policy. If this whole process dies,
PX4 holds after COM_OF_LOSS_T (COM_OBL_RC_ACT) and ArduCopter after GUID_TIMEOUT, which is why the preflight audit
insists on them; `guard` then sends the other orders. All times are fleet time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from skyfolio.mavlink_bridge.autopilots import FlightMode
from skyfolio.mavlink_bridge.confirming import error_of, is_ours, not_ours
from skyfolio.mavlink_bridge.departure import start
from skyfolio.mavlink_bridge.deviations import AltitudeWatch, Deviation, HomeWatch
from skyfolio.mavlink_bridge.flight import hold, set_current, set_mode
from skyfolio.mavlink_bridge.items import Mission
from skyfolio.mavlink_bridge.keeper import Keeper, Order, Slip
from skyfolio.mavlink_bridge.speeds import order_speed, require_in_mission, restore_speed
from skyfolio.mavlink_bridge.stream import RATE_HZ, Streamer
from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle
from skyfolio.planner.geodesy import geodetic_to_east_north
from skyfolio.planner.scenario import Origin

LOOK_S = 0.1
"""Fleet seconds between two looks of the keeper."""
SHORTEST_SLEEP_S = 0.005
"""Wall seconds; a fleet whose clock runs much faster than this is looked at less often."""
FRESH_S = 2.0
"""A position older than this (fleet seconds) is not used to steer."""
PREPARE_S = 1.2
"""Fleet seconds of setpoints before the mode is changed: PX4 refuses OFFBOARD without them."""


class FallBack(StrEnum):
    """What vehicles do when their stream of setpoints ends before the plan does."""

    MISSION = "mission"
    """Fly the mission on board on, from the waypoint of the current slot."""
    HOLD = "hold"


@dataclass(frozen=True, kw_only=True)
class Kept:
    """One vehicle under a keeper; `origin` is where its plan's (0, 0) lies. `altitude`, `home`: what is watched."""

    vehicle: Vehicle
    keeper: Keeper
    origin: Origin
    altitude: AltitudeWatch | None = None
    home: HomeWatch | None = None

    def is_on_board(self) -> bool:
        """Return whether the vehicle is proven to have the mission that is kept."""
        return self.vehicle.on_board == self.keeper.mission.items


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

    elapsed_s: fleet seconds since slot 0 of their plans. now_s: the fleet's clock. scale: fleet seconds per wall
    second. on_slip(system_id, slip): called once for each vehicle and slot; on_order: for each order sent;
    on_deviation: when the altitude or the home of a vehicle is not as planned.
    """
    giving: dict[int, asyncio.Task[None]] = {}
    try:
        while True:
            for system_id, watched in kept.items():
                order, slip, deviations = _look(watched, elapsed_s(), now_s())
                if slip is not None:
                    on_slip(system_id, slip)
                for deviation in deviations:
                    on_deviation(system_id, deviation)
                if order is None:
                    continue
                if system_id in giving and not giving[system_id].done():
                    watched.keeper.not_taken(order)
                    continue
                on_order(system_id, order)
                giving[system_id] = asyncio.create_task(_give(watched, order))
            await asyncio.sleep(max(LOOK_S / scale, SHORTEST_SLEEP_S))
    finally:
        for task in giving.values():
            task.cancel()
        await asyncio.gather(*giving.values(), return_exceptions=True)


def _look(watched: Kept, elapsed_s: float, now_s: float) -> tuple[Order | None, Slip | None, list[Deviation]]:
    snapshot = watched.vehicle.state.snapshot()
    if snapshot is None or snapshot.place_deg is None or now_s - snapshot.heard_at_s > FRESH_S:
        return None, None, []
    age_s = now_s - snapshot.heard_at_s
    velocity = (snapshot.velocity_east_mps, snapshot.velocity_north_mps)
    east, north = geodetic_to_east_north(watched.origin, *snapshot.place_deg)
    point = (east + velocity[0] * age_s, north + velocity[1] * age_s)
    order = None
    if snapshot.mode is FlightMode.MISSION and snapshot.mission_current is not None:
        order = watched.keeper.advise(elapsed_s, point, velocity, snapshot.mission_current)
    return order, watched.keeper.slip(elapsed_s, point), list(_deviations(watched, snapshot, elapsed_s))


def _deviations(watched: Kept, snapshot: Telemetry, elapsed_s: float) -> Iterator[Deviation]:
    """Yield deviations: of altitude while the vehicle is ours and slots are flown, of its home whenever it moves."""
    state = watched.vehicle.state
    home = None if watched.home is None else watched.home.look(state.home_deg, state.home_amsl_m)
    if home is not None:
        yield home
    if watched.altitude is not None and is_ours(watched.vehicle) and 0 <= elapsed_s < watched.keeper.ends_s:
        altitude = watched.altitude.look(elapsed_s, snapshot.relative_alt_m, snapshot.altitude_amsl_m)
        if altitude is not None:
            yield altitude


async def _give(watched: Kept, order: Order) -> None:
    """Send an order to a vehicle that is seen in its mission just now; if it fails, a later look sends it again.

    An item is one of the mission that is kept: in another, which is sent meanwhile, its number may be the landing.
    """
    try:
        if order.item is not None:
            await require_in_mission(watched.vehicle)
            await set_current(watched.vehicle, order.item, may=watched.is_on_board)
        elif order.its_own_speed:
            await restore_speed(watched.vehicle, order.speed_mps or watched.keeper.model.cruise_mps)
        elif order.speed_mps is not None:
            await order_speed(watched.vehicle, order.speed_mps)
    except NotDone:
        watched.keeper.not_taken(order)


@dataclass(frozen=True, kw_only=True)
class Streamed:
    """One vehicle guided by setpoints, with the mission it falls back on, which is on board.

    began_s: when slot 0 of the streamer's path and of the mission begins, fleet seconds since slot 0 of the stream.
    """

    vehicle: Vehicle
    streamer: Streamer
    mission: Mission
    began_s: float = 0.0

    @property
    def ends_s(self) -> float:
        """Return when the last slot of its path ends."""
        route = self.streamer.route
        return self.began_s + (route.last + 1) * route.slot_s

    def item_at(self, elapsed_s: float) -> int:
        """Return the waypoint that its mission flies to from that fleet second on."""
        route = self.streamer.route
        return self.mission.item_of_slot(next_slot(elapsed_s - self.began_s, route.slot_s, route.last))


class Stream:
    """Streams setpoints to several vehicles. `begin` changes the mode, `run` guides until the plan or the process ends.

    `elapsed_s()` is fleet seconds since slot 0 began, and negative before. `scale`: fleet seconds per wall second.
    While it runs a vehicle may `go_on` by another path and mission, as long as there are more.
    """

    def __init__(self, streamed: Mapping[int, Streamed], *, scale: float, fall_back: FallBack) -> None:
        self._streamed = dict(streamed)
        self._next: dict[int, Streamed] = {}
        """What vehicles go on by as soon as it begins."""
        self._scale = scale
        self._fall_back = fall_back
        self._ended = False
        self._handing: dict[int, asyncio.Task[str | None]] = {}

    async def begin(self) -> dict[int, str | None]:
        """Stream the first points, change the mode, and return for each vehicle what went wrong, or None."""
        until = asyncio.get_running_loop().time() + max(PREPARE_S / self._scale, 0.2)
        while asyncio.get_running_loop().time() < until:
            self._send(-1.0)
            await self._pause()
        changing = {
            system_id: asyncio.create_task(_mode_error(streamed.vehicle))
            for system_id, streamed in self._streamed.items()
        }
        while not all(task.done() for task in changing.values()):
            self._send(-1.0)
            await self._pause()
        return {system_id: task.result() for system_id, task in changing.items()}

    async def run(self, elapsed_s: Callable[[], float]) -> None:
        """Guide until the last slot ends. However it ends, no vehicle is left without guidance.

        A vehicle that is let go gets setpoints until it flies something else: a PX4 whose setpoints end first holds.
        """
        try:
            while not self._ended and elapsed_s() < self._ends_s():
                self._send(elapsed_s())
                await self._pause()
        finally:
            self.hand_over(elapsed_s())
            while not all(task.done() for task in self._handing.values()):
                self._send(elapsed_s())
                await self._pause()

    def go_on(self, system_id: int, by: Streamed) -> None:
        """Let a vehicle go on by another path once that begins, and fall back on its mission from now on."""
        if system_id in self._streamed:
            self._next[system_id] = by

    def leave(self, system_id: int) -> None:
        """Stop sending to one vehicle, and leave its mode to what flies it now, at once."""
        self._streamed.pop(system_id, None)
        self._next.pop(system_id, None)
        if system_id in self._handing:
            self._handing[system_id].cancel()

    def hand_over(self, elapsed_s: float) -> Mapping[int, asyncio.Task[str | None]]:
        """Let each vehicle go, once; return the tasks that do it, by system id."""
        if not self._ended:
            self._ended = True
            self._handing = {
                system_id: asyncio.create_task(
                    let_go(streamed.vehicle, streamed.item_at(elapsed_s), self._fall_back),
                    name=f"let-go-{system_id}",
                )
                for system_id, streamed in self._newest().items()
            }
        return self._handing

    def drop(self) -> None:
        """Stop the setpoints and send nothing in their place: the caller commands the vehicles from now on."""
        self._ended = True
        for task in self._handing.values():
            task.cancel()
        self._handing = {}

    def _newest(self) -> dict[int, Streamed]:
        """Return what each vehicle has on board, whether its path has begun or not."""
        return {system_id: self._next.get(system_id, streamed) for system_id, streamed in self._streamed.items()}

    def _ends_s(self) -> float:
        return max((streamed.ends_s for streamed in self._newest().values()), default=0.0)

    def _send(self, elapsed_s: float) -> None:
        for system_id, by in list(self._next.items()):
            if elapsed_s >= by.began_s:
                self._streamed[system_id] = self._next.pop(system_id)
        for system_id, streamed in list(self._streamed.items()):
            if system_id in self._handing and self._handing[system_id].done():
                continue  # it flies something else
            at_s = elapsed_s - streamed.began_s
            try:
                streamed.vehicle.send(streamed.streamer.setpoint(at_s, streamed.vehicle.state.boot_ms or 0))
            except NotDone:
                continue

    async def _pause(self) -> None:
        await asyncio.sleep(max(1 / RATE_HZ / self._scale, SHORTEST_SLEEP_S))


def next_slot(elapsed_s: float, slot_s: float, last: int) -> int:
    """Return the slot whose waypoint is flown to when missions take over: the next to begin, at most the last."""
    return min(max(int(elapsed_s // slot_s) + 1, 0), last)


async def let_go(vehicle: Vehicle, item: int, fall_back: FallBack) -> str | None:
    """Fly the mission on board from `item` on, or hold by policy or if that fails; return what went wrong, or None.

    A vehicle that somebody else flies is left to them. One that hovers because its setpoints came late (PX4 leaves
    OFFBOARD then) is still ours.
    """
    if not is_ours(vehicle):
        return not_ours(vehicle)
    if fall_back is FallBack.HOLD:
        return await error_of(hold(vehicle))
    error = await error_of(_fly_from(vehicle, item))
    if error is not None:
        await error_of(hold(vehicle))
    return error


async def _fly_from(vehicle: Vehicle, item: int) -> None:
    await set_current(vehicle, item)
    await start(vehicle, item)


async def _mode_error(vehicle: Vehicle) -> str | None:
    return await error_of(_enter_stream_mode(vehicle))


async def _enter_stream_mode(vehicle: Vehicle) -> None:
    await set_mode(vehicle, vehicle.profile.stream_mode)
