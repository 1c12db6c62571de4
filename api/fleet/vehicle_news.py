"""What the link says of registered vehicles: events for everybody, and what is remembered of each."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.store.event_log import EventLog
from skyfolio.mavlink_bridge import FleetLink, LinkEvent
from skyfolio.mavlink_bridge.conditions import Change, Condition
from skyfolio.mavlink_bridge.findings import Finding, warning
from skyfolio.mavlink_bridge.senders import SenderKind, SenderNotice
from skyfolio.mavlink_bridge.speeds import SpeedRestored

ASK_EVERY_S = 0.5
"""Wall seconds between two looks for vehicles that were not asked for their telemetry yet."""
_FORGETS_STREAMS = frozenset({Condition.REBOOTED, Condition.DISARMED})
"""A restarted ArduCopter streams nothing until it is asked again."""
_TOLD_AS_LINK = frozenset(
    {Condition.LIVE, Condition.STALE, Condition.BACK, Condition.LINK_LOST, Condition.AUTOPILOT_SILENT}
)
"""Changes between these are told by `link` events."""


class FleetNews:
    """Follows one link. `systems`: the registry, system ids by UAV id, as it changes; others are not spoken of."""

    def __init__(self, systems: Mapping[str, int], events: EventLog) -> None:
        self._systems, self._events = systems, events
        self.changes: dict[int, Change] = {}
        """The newest condition of each system; none while it has always been live."""
        self._doubts: dict[int, SenderNotice] = {}
        """Systems of which it is not certain who speaks for them, and why."""
        self._asked: set[int] = set()
        """Who was asked for its telemetry."""
        self._followers: set[asyncio.Queue[LinkEvent]] = set()

    def start(self, link: FleetLink, background: Supervisor) -> list[asyncio.Task[None]]:
        """Follow this link; the tasks that do."""
        link.speeds.tell = self._speed_restored
        return [
            background.start("fleet-links", lambda: self._watch(link)),
            background.start("fleet-conditions", lambda: self._watch_conditions(link)),
            background.start("fleet-streams", lambda: self._ask(link)),
        ]

    def forget(self, system_id: int) -> None:
        """Remember nothing of a vehicle that is no longer registered."""
        self.changes.pop(system_id, None)
        self._doubts.pop(system_id, None)
        self._asked.discard(system_id)

    def follow(self) -> asyncio.Queue[LinkEvent]:
        """A queue that gets every link event from now on; give it back to `unfollow`."""
        queue: asyncio.Queue[LinkEvent] = asyncio.Queue()
        self._followers.add(queue)
        return queue

    def unfollow(self, queue: asyncio.Queue[LinkEvent]) -> None:
        """Stop filling the queue."""
        self._followers.discard(queue)

    def note_sender(self, notice: SenderNotice) -> None:
        """Report who speaks for a vehicle: a move, a second sender, a second link. Unsigned, it is a warning."""
        uav_id = next((uav for uav, system in self._systems.items() if system == notice.system_id), None)
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
        """Return a preflight warning if it is not certain who speaks for this vehicle."""
        notice = self._doubts.get(system_id)
        if notice is None:
            return []
        found = f"{notice.kind.value.replace('_', ' ')}: {notice.before}, then {notice.now}"
        return [warning("sender", found, "one sender, or signed frames", "another aircraft may have its system id")]

    def _speed_restored(self, restored: SpeedRestored) -> None:
        names = {system: uav for uav, system in self._systems.items()}
        if restored.system_id in names:
            self._events.add(
                "speed_restored",
                uav_id=names[restored.system_id],
                level="ok" if restored.error is None else "warning",
                mode=restored.mode.value,
                speed_mps=restored.speed_mps,
                error=restored.error,
            )

    async def _watch(self, link: FleetLink) -> None:
        async for event in link.events():
            names = {system: uav for uav, system in self._systems.items()}
            if event.system_id not in names:
                continue
            self._events.add(
                "link",
                uav_id=names[event.system_id],
                before=event.before.value,
                after=event.after.value,
                silent_for_s=round(event.silent_for_s, 3),
            )
            for queue in self._followers:
                queue.put_nowait(event)

    async def _ask(self, link: FleetLink) -> None:
        """Ask whoever is heard for its telemetry, so that it shows before a flight: ArduCopter sends none unasked."""
        while True:
            new = link.heard_systems.intersection(self._systems.values()) - self._asked
            self._asked |= new
            await link.ask_for_streams(new)
            await asyncio.sleep(ASK_EVERY_S)

    async def _watch_conditions(self, link: FleetLink) -> None:
        async for change in link.changes():
            names = {system: uav for uav, system in self._systems.items()}
            if change.system_id not in names:
                continue
            self.changes[change.system_id] = change
            if change.after in _FORGETS_STREAMS:
                self._asked.discard(change.system_id)
            if not {change.before, change.after} <= _TOLD_AS_LINK:
                self._events.add(
                    "condition",
                    uav_id=names[change.system_id],
                    before=change.before.value,
                    after=change.after.value,
                    cause=change.cause,
                )
