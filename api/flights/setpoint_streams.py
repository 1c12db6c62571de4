"""Setpoints for the UAVs of one flight, and the guard that speaks for us should this process die meanwhile."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Mapping

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.mavlink_bridge import GuardFailed, east_north_to_geodetic
from skyfolio.mavlink_bridge.guard import Guard, Orders
from skyfolio.mavlink_bridge.guidance import FallBack, Stream, Streamed
from skyfolio.mavlink_bridge.stream import Streamer

SILENT_S = 2.0
"""Fleet seconds; an autopilot that sends its position five times a second and is not heard for so long is not there."""


class SetpointStreams:
    """A stream to several UAVs. `elapsed_s()`: fleet seconds since slot 0 began.

    fall_back: what they do when the stream ends, because it is no longer wanted or because this process is killed.
    """

    def __init__(
        self,
        systems: Mapping[str, int],
        fleet: Fleet,
        clock: FleetClock,
        *,
        elapsed_s: Callable[[], float],
        fall_back: FallBack,
    ) -> None:
        self._systems, self._fleet, self._clock = systems, fleet, clock
        self._elapsed_s, self._fall_back = elapsed_s, fall_back
        self._given: dict[str, AssignedMission] = {}
        self._stream: Stream | None = None
        self._task: asyncio.Task[None] | None = None
        self._handing: Mapping[int, asyncio.Task[str | None]] = {}
        self._closing: set[asyncio.Task[None]] = set()
        self._guard: Guard | None = None
        self._slot0_at = 0.0

    @property
    def is_on(self) -> bool:
        """Whether setpoints are being sent."""
        return self._task is not None and not self._task.done()

    async def prepare(self, given: Mapping[str, AssignedMission]) -> dict[int, str | None]:
        """Put these UAVs into the mode that follows setpoints; for each system what went wrong, or None."""
        self._given = dict(given)
        await self._post_guard()
        self._stream = Stream(
            {self._systems[uav]: self._streamed(uav, one) for uav, one in given.items()},
            scale=self._clock.scale,
            fall_back=self._fall_back,
        )
        return await self._stream.begin()

    def begin(self) -> None:
        """Slot 0 begins."""
        if self._stream is None:
            return
        self._slot0_at = time.time()
        self._task = asyncio.create_task(self._stream.run(self._elapsed_s), name="stream")
        self._task.add_done_callback(lambda _done: self._dismiss_guard())
        self._tell_guard(self._given)

    def leave(self, uav: str) -> None:
        """Send this one nothing any more."""
        if self._stream is not None and self._given.pop(uav, None) is not None:
            self._stream.leave(self._systems[uav])
            if self._task is not None:
                self._tell_guard(self._given)

    async def end(self, uavs: Collection[str] | None = None) -> None:
        """No setpoints any more: every UAV falls back. Returns when these have, or have failed to; whoever asks first.

        None: all that are heard. One that has fallen silent is not waited for: its command takes seconds to fail.
        """
        if self._stream is not None and self._task is not None:
            self._handing = self._stream.hand_over(self._elapsed_s())
        systems = self._heard() if uavs is None else {self._systems[uav] for uav in uavs}
        waited = [task for system, task in self._handing.items() if system in systems]
        if waited:
            await asyncio.wait(waited)

    def drop(self) -> None:
        """No setpoints any more, from this moment, and nothing in their place; nothing is waited for."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.drop()
        self._handing = {}
        self._dismiss_guard()

    async def close(self) -> None:
        """After `end`: the process that guards ends, and so do commands to who does not answer."""
        self.drop()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        await asyncio.gather(*self._closing)

    def _heard(self) -> set[int]:
        monitor, now_s = self._fleet.link.monitor, self._clock.now()
        return {
            system
            for system in self._handing
            if system in monitor.watched and monitor.silent_for_s(system, now_s) < SILENT_S
        }

    def _dismiss_guard(self) -> None:
        """Nobody streams any more: the guard has nothing to do, whatever becomes of us."""
        self._tell_guard({})
        guard, self._guard = self._guard, None
        if guard is not None:
            task = asyncio.create_task(guard.close(), name="dismiss-guard")
            self._closing.add(task)
            task.add_done_callback(self._closing.discard)

    async def _post_guard(self) -> None:
        """Without one vehicles hold when this process dies, which is worth a warning and no reason to stay down."""
        if self._fall_back is FallBack.HOLD or all(map(self._fleet.is_simulated, self._given)):
            return  # a hold needs nobody to order it, and a fleet inside this process dies with it
        guard = Guard()
        try:
            await guard.start()
        except GuardFailed as error:
            self._warn(error)
        else:
            self._guard = guard

    def _tell_guard(self, given: Mapping[str, AssignedMission]) -> None:
        if self._guard is None:
            return
        orders = None
        if given:
            orders = Orders(
                links=self._fleet.links,
                signing_key_file=self._fleet.signing_key_file,
                slot0_at=self._slot0_at,
                scale=self._clock.scale,
                slot_s=next(iter(given.values())).slot_s,
                items={self._systems[uav]: _items(one) for uav, one in given.items()},
            )
        try:
            self._guard.orders(orders)
        except GuardFailed as error:
            self._guard = None
            self._warn(error)

    def _warn(self, error: GuardFailed) -> None:
        self._fleet.note("guard", level="warning", error=str(error))

    def _streamed(self, uav: str, one: AssignedMission) -> Streamed:
        system = self._systems[uav]
        streamer = Streamer(
            system,
            one.path_m,
            one.slot_s,
            one.altitude_m,
            lambda point: east_north_to_geodetic(one.origin, *point),
        )
        return Streamed(vehicle=self._fleet.link.vehicle(system), streamer=streamer, mission=one.mission)


def _items(one: AssignedMission) -> tuple[int, ...]:
    return tuple(one.mission.item_of_slot(slot) for slot in range(len(one.path_m)))
