"""What the link reports of registered vehicles: events for everybody, and what is remembered of each vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.store.event_log import EventLog
from skyfolio.mavlink_bridge import FleetLink, LinkEvent, LinkState
from skyfolio.mavlink_bridge.conditions import Change, Condition, VehicleChange
from skyfolio.mavlink_bridge.findings import Finding, warning
from skyfolio.mavlink_bridge.senders import SenderKind, SenderNotice
from skyfolio.mavlink_bridge.speeds import SpeedRestored

ASK_EVERY_S = 0.5
"""Wall seconds between looks for vehicles that have not been asked for their telemetry yet."""
_FORGETS_STREAMS = frozenset({Condition.REBOOTED, Condition.DISARMED})
"""A restarted ArduCopter sends no telemetry until it is asked again. A vehicle that was not heard for a while is asked
anew, too, and on the ground after a short while already: it may have been switched off or have restarted, and nothing
but its positions shows that."""


class FleetNews:
    """Follows one link.

    systems: the registry, system ids by UAV id, which may change; vehicles that are not in it are not reported.
    is_of_another: whether another service has a vehicle, and reports it.
    """

    def __init__(
        self,
        systems: Mapping[str, int],
        events: EventLog,
        is_of_another: Callable[[int], bool] = lambda _system_id: False,
    ) -> None:
        self._systems, self._events, self._is_of_another = systems, events, is_of_another
        self.changes: dict[int, Change] = {}
        """The newest condition of each system; none while it has always been live."""
        self._doubts: dict[int, SenderNotice] = {}
        """Systems whose messages may come from more than one sender, and why."""
        self._asked: set[int] = set()
        """Systems that were asked for their telemetry."""
        self._followers: set[asyncio.Queue[LinkEvent]] = set()

    def start(self, link: FleetLink, background: Supervisor) -> list[asyncio.Task[None]]:
        """Follow this link; return the tasks that do so."""
        link.speeds.tell = self._speed_restored
        return [
            background.start("fleet-changes", lambda: self._watch(link)),
            background.start("fleet-streams", lambda: self._ask(link)),
        ]

    def forget(self, system_id: int) -> None:
        """Forget a vehicle that is no longer registered."""
        self.changes.pop(system_id, None)
        self._doubts.pop(system_id, None)
        self._asked.discard(system_id)

    def follow(self) -> asyncio.Queue[LinkEvent]:
        """Return a queue that is sent every change of a link's state from now on; give it back to `unfollow`."""
        queue: asyncio.Queue[LinkEvent] = asyncio.Queue()
        self._followers.add(queue)
        return queue

    def unfollow(self, queue: asyncio.Queue[LinkEvent]) -> None:
        """Stop filling the queue."""
        self._followers.discard(queue)

    def note_sender(self, notice: SenderNotice) -> None:
        """Report that a vehicle has moved to another address, has a second sender or a second link.

        Unsigned, it is a warning.
        """
        uav_id = self._uav_of(notice.system_id)
        doubtful = notice.kind is SenderKind.CONTESTED or not notice.signed
        if doubtful:
            self._doubts[notice.system_id] = notice
        self._events.add(
            notice.kind.value,
            uav_id=uav_id,
            system_id=notice.system_id,
            component_id=notice.component_id,
            before=notice.before,
            now=notice.now,
            signed=notice.signed,
            level="warning" if doubtful else "ok",
        )

    def doubts_about(self, system_id: int) -> list[Finding]:
        """Return a preflight warning if more than one sender may use this vehicle's system id."""
        notice = self._doubts.get(system_id)
        if notice is None:
            return []
        found = f"{notice.kind.value.replace('_', ' ')}: {notice.before}, then {notice.now}"
        return [warning("sender", found, "one sender, or signed frames", "another aircraft may have its system id")]

    def _speed_restored(self, restored: SpeedRestored) -> None:
        uav_id = self._uav_of(restored.system_id)
        if uav_id is not None:
            self._events.add(
                "speed_restored",
                uav_id=uav_id,
                level="ok" if restored.error is None else "warning",
                mode=restored.mode.value,
                speed_mps=restored.speed_mps,
                error=restored.error,
            )

    async def _watch(self, link: FleetLink) -> None:
        async for change in link.changes():
            uav_id = self._uav_of(change.system_id)
            if uav_id is not None:
                telemetry = link.telemetry(change.system_id)
                self._take_in(uav_id, change, stands=telemetry is None or not telemetry.armed)

    def _take_in(self, uav_id: str, change: VehicleChange, *, stands: bool) -> None:
        """Remember the new condition of one vehicle, and report what changed: each fact in one event.

        stands: whether it is not known to be armed.
        """
        condition = change.condition
        if condition is not None:
            self.changes[change.system_id] = condition
            if condition.after in _FORGETS_STREAMS:
                self._asked.discard(change.system_id)
        for step in change.link:
            if step.after is LinkState.LOST or (step.after is LinkState.LIVE and stands):
                self._asked.discard(change.system_id)
            for queue in self._followers:
                queue.put_nowait(step)
        if not self._is_of_another(change.system_id):
            self._report(uav_id, change)

    def _report(self, uav_id: str, change: VehicleChange) -> None:
        condition = change.condition
        for step in change.link:
            is_newest = step is change.link[-1]
            self._events.add(
                "link",
                uav_id=uav_id,
                before=step.before.value,
                after=step.after.value,
                silent_for_s=round(step.silent_for_s, 3),
                cause=condition.cause if is_newest and condition is not None and change.is_of_link_only else None,
            )
        if condition is not None and not change.is_of_link_only:
            self._events.add(
                "condition",
                uav_id=uav_id,
                before=condition.before.value,
                after=condition.after.value,
                cause=condition.cause,
            )

    def _uav_of(self, system_id: int) -> str | None:
        return next((uav for uav, system in self._systems.items() if system == system_id), None)

    async def _ask(self, link: FleetLink) -> None:
        """Ask each vehicle for its telemetry once it is heard: ArduCopter sends none unasked."""
        while True:
            heard = {system for system in self._systems.values() if link.is_heard(system)}
            others = set(filter(self._is_of_another, heard))  # they are asked anew once they are ours
            self._asked -= others
            unasked = heard - others - self._asked
            self._asked |= unasked
            await link.ask_for_streams(unasked)
            await asyncio.sleep(ASK_EVERY_S)
