"""Setpoints for the UAVs of one flight, and the guard that commands them if this process dies meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.fleet_ports import GuardPort
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.mavlink_bridge import GuardFailed, east_north_to_geodetic
from skyfolio.mavlink_bridge.guard import Orders
from skyfolio.mavlink_bridge.guidance import FallBack, Stream, Streamed
from skyfolio.mavlink_bridge.stream import Streamer
from skyfolio.planner.geometry import Point

SILENT_S = 2.0
"""Fleet seconds without a message after which an autopilot, which sends its position at 5 Hz, is not waited for."""


class SetpointStreams:
    """Sends setpoints to several UAVs.

    elapsed_s: returns fleet seconds since slot 0 began. fall_back: what UAVs do when the stream ends, because it is no
    longer needed or because this process is killed.
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
        self._streamed: dict[str, AssignedMission] = {}
        self._stream: Stream | None = None
        self._task: asyncio.Task[None] | None = None
        self._hand_overs: Mapping[int, asyncio.Task[str | None]] = {}
        self._closing: set[asyncio.Task[None]] = set()
        self._guard: GuardPort | None = None
        self._slot0_at = 0.0

    @property
    def is_on(self) -> bool:
        """Return whether setpoints are being sent."""
        return self._task is not None and not self._task.done()

    async def prepare(self, missions: Mapping[str, AssignedMission]) -> dict[int, str | None]:
        """Put these UAVs into the mode that follows setpoints; return for each system what went wrong, or None."""
        self._streamed = dict(missions)
        await self._post_guard()
        self._stream = Stream(
            {
                self._systems[uav]: self._streamed_of(uav, assigned, assigned.path_m)
                for uav, assigned in missions.items()
            },
            scale=self._clock.scale,
            fall_back=self._fall_back,
        )
        return await self._stream.begin()

    def begin(self) -> None:
        """Send setpoints from now on: slot 0 begins."""
        if self._stream is None:
            return
        self._slot0_at = self._clock.utc_of(0.0)
        self._task = asyncio.create_task(self._stream.run(self._elapsed_s), name="stream")
        self._task.add_done_callback(lambda _done: self._dismiss_guard())
        self._instruct_guard(self._streamed)

    def renew_guard(self) -> None:
        """Let the guard know that we may command the vehicles for longer."""
        if self._guard is not None and self._task is not None and self._streamed:
            self._instruct_guard(self._streamed)

    def streams_to(self, uav: str) -> bool:
        """Return whether setpoints are being sent to this UAV, and not only until it flies its mission."""
        return self.is_on and uav in self._streamed and not self._hand_overs

    def unguard(self, uav: str) -> None:
        """Keep the guard from commanding a UAV while it is not certain which mission it has on board: it would hold."""
        self._instruct_guard({one: assigned for one, assigned in self._streamed.items() if one != uav})

    def go_on(self, uav: str, assigned: AssignedMission, path_m: Sequence[Point]) -> None:
        """Let a UAV go on by this path once its first slot begins; the mission is on board from now on.

        path_m: (n, 2) metres east/north, where the UAV shall be when the slots of the mission begin.
        """
        if self._stream is None or uav not in self._streamed:
            return
        self._streamed[uav] = assigned
        self._stream.go_on(self._systems[uav], self._streamed_of(uav, assigned, path_m))
        self._instruct_guard(self._streamed)

    def leave(self, uav: str) -> None:
        """Stop sending setpoints to this UAV."""
        if self._stream is not None and self._streamed.pop(uav, None) is not None:
            self._stream.leave(self._systems[uav])
            if self._task is not None:
                self._instruct_guard(self._streamed)

    async def end(self, uavs: Collection[str] | None = None) -> None:
        """End the stream, so that every UAV falls back; return when these have, or have failed to.

        uavs: None waits for all that are heard. A UAV that has fallen silent is not waited for, because its command
        takes seconds to fail. Calling it again joins the first call.
        """
        if self._stream is not None and self._task is not None:
            self._hand_overs = self._stream.hand_over(self._elapsed_s())
        systems = self._heard() if uavs is None else {self._systems[uav] for uav in uavs}
        awaited = [task for system, task in self._hand_overs.items() if system in systems]
        if awaited:
            await asyncio.wait(awaited)
        self._guard_only_the_rest()

    def _guard_only_the_rest(self) -> None:
        """Let the guard see only to those that still get setpoints: others may be sent another mission next.

        What it would make current is an item of the mission that they fell back on.
        """
        over = {system for system, task in self._hand_overs.items() if task.done()}
        if over:
            self._streamed = {uav: one for uav, one in self._streamed.items() if self._systems[uav] not in over}
            self._instruct_guard(self._streamed)

    def drop(self) -> None:
        """End the stream at once, with nothing in its place, and wait for nothing."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.drop()
        self._hand_overs = {}
        self._dismiss_guard()

    async def close(self) -> None:
        """End the guard, and commands to vehicles that do not answer. To be called after `end`."""
        self.drop()
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        await asyncio.gather(*self._closing)

    def _heard(self) -> set[int]:
        monitor, now_s = self._fleet.link.monitor, self._clock.now()
        return {
            system
            for system in self._hand_overs
            if system in monitor.watched and monitor.silent_for_s(system, now_s) < SILENT_S
        }

    def _dismiss_guard(self) -> None:
        """End the guard: setpoints are no longer sent, so there is nothing to take over."""
        self._instruct_guard({})
        guard, self._guard = self._guard, None
        if guard is not None:
            task = asyncio.create_task(guard.close(), name="dismiss-guard")
            self._closing.add(task)
            task.add_done_callback(self._closing.discard)

    async def _post_guard(self) -> None:
        """Start the guard. Without one vehicles hold if this process dies, which is worth a warning and no failure."""
        if self._fall_back is FallBack.HOLD or all(map(self._fleet.is_simulated, self._streamed)):
            return  # a hold needs no order, and a fleet simulated in this process dies with it
        guard = self._fleet.new_guard()
        try:
            await guard.start()
        except GuardFailed as error:
            self._warn(error)
        else:
            self._guard = guard

    def _instruct_guard(self, missions: Mapping[str, AssignedMission]) -> None:
        if self._guard is None:
            return
        orders = None
        if missions:
            first, slot_s = min(one.first_slot for one in missions.values()), next(iter(missions.values())).slot_s
            orders = Orders(
                links=self._fleet.links,
                signing_key_file=self._fleet.signing_key_file,
                slot0_at=self._slot0_at + first * slot_s / self._clock.scale,
                scale=self._clock.scale,
                slot_s=slot_s,
                items={self._systems[uav]: _items(assigned, first) for uav, assigned in missions.items()},
                until_s=self._fleet.rights.until_s(self._systems[uav] for uav in missions),
            )
        try:
            self._guard.orders(orders)
        except GuardFailed as error:
            self._guard = None
            self._warn(error)

    def _warn(self, error: GuardFailed) -> None:
        self._fleet.note("guard", level="warning", error=str(error))

    def _streamed_of(self, uav: str, assigned: AssignedMission, path_m: Sequence[Point]) -> Streamed:
        system = self._systems[uav]
        streamer = Streamer(
            system,
            list(path_m),
            assigned.slot_s,
            assigned.altitudes,
            lambda point: east_north_to_geodetic(assigned.origin, *point),
        )
        vehicle = self._fleet.link.vehicle(system)
        return Streamed(vehicle=vehicle, streamer=streamer, mission=assigned.mission, began_s=assigned.began_s)


def _items(assigned: AssignedMission, first: int) -> tuple[int, ...]:
    """Return the waypoint of each slot of the operation from `first` on; until the mission begins it is its first."""
    mission = assigned.mission
    before = assigned.first_slot - first
    return tuple(mission.item_of_slot(max(slot, 0)) for slot in range(-before, len(assigned.path_m)))
