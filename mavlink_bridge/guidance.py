"""Guide vehicles while a plan is flown: a stream of setpoints (`keeping` has the schedule keeper over missions).

When the stream ends, for whatever reason, the vehicles fly the mission on board or hold, by policy. If this whole
process dies, PX4 holds after COM_OF_LOSS_T (COM_OBL_RC_ACT) and ArduCopter after GUID_TIMEOUT, which is why the
preflight audit insists on them; `guard` then sends the other orders. All times are fleet time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from skyfolio.mavlink_bridge.confirming import error_of, is_ours, not_ours, require_ours
from skyfolio.mavlink_bridge.departure import start
from skyfolio.mavlink_bridge.flight import hold, set_current, set_mode
from skyfolio.mavlink_bridge.items import Mission
from skyfolio.mavlink_bridge.keeping import SHORTEST_SLEEP_S
from skyfolio.mavlink_bridge.stream import RATE_HZ, Streamer
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle

PREPARE_S = 1.2
"""Fleet seconds of setpoints before the mode is changed: PX4 refuses OFFBOARD without them."""


class FallBack(StrEnum):
    """What vehicles do when their stream of setpoints ends before the plan does."""

    MISSION = "mission"
    """Fly the mission on board on, from the waypoint of the current slot."""
    HOLD = "hold"


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
    require_ours(vehicle)
    await set_mode(vehicle, vehicle.profile.stream_mode)
