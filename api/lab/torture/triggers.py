"""Strikes each blow of a drill at its moment: on journal steps and states as they happen, and on the clock."""

from __future__ import annotations

import json
from collections import Counter

from skyfolio.api.flights.journal import Entry
from skyfolio.api.lab.torture.blows import BLOWS, Arena, name_of
from skyfolio.api.lab.torture.drill import Blow
from skyfolio.api.service import Service
from skyfolio.api.store.event_log import Event


class Triggers:
    """The blows that have not struck yet."""

    def __init__(self, arena: Arena, blows: tuple[Blow, ...]) -> None:
        self._arena = arena
        self._waiting = list(blows)
        self._steps: Counter[tuple[str, bool]] = Counter()
        self._states: Counter[str] = Counter()
        self._news: Counter[str] = Counter()
        self._truth_seen = 0
        self._seen = arena.seen
        arena.on_restart = self.follow

    def begin(self) -> None:
        """Begin to wait for the blows that are due so long after the operation was created, which is now."""
        for blow in [one for one in self._waiting if one.when.is_by_time]:
            self._due(blow)

    def follow(self, service: Service) -> None:
        """Follow the journal of a service that was just started."""
        for one in self._seen.each:
            one.note_start()
        ground = self._arena.ground
        service.journal.listeners.append(
            lambda entry, stored: self._step(entry, stored) if ground.service in (service, None) else None
        )

    def note(self, event: Event) -> None:
        """Take in an event as it is stored."""
        for one in self._seen.each:
            one.note_event(event)
        self._seen.tell(f"event   {event.id} {event.kind} {json.dumps(event.data)}")
        if event.kind != "operation" or event.data.get("operation_id") != self._seen.operation_id:
            return
        state = self._seen.state
        self._states[state] += 1
        for blow in [one for one in self._waiting if one.when.state is not None]:
            if blow.when.state == state and blow.when.nth == self._states[state]:
                self._due(blow)

    def look(self) -> None:
        """Take in what happened to vehicles in the last step of the fleet."""
        events = self._arena.ground.fleet.truth.events
        new, self._truth_seen = events[self._truth_seen :], len(events)
        for event in new:
            self._seen.tell(f"vehicle {event.system_id} {event.kind} {event.detail or ''}")
            self._news[event.kind] += 1
            for blow in [one for one in self._waiting if one.when.vehicle == event.kind]:
                if blow.when.nth == self._news[event.kind]:
                    self._due(blow)

    def _step(self, entry: Entry, stored: bool) -> None:
        if stored:
            for one in self._seen.each:
                one.note_step(entry)
            self._seen.tell(
                f"journal {entry.incident} {entry.step.value} {entry.uav_id or ''} {json.dumps(entry.data)}"
            )
        self._steps[entry.step.value, stored] += 1
        for blow in [one for one in self._waiting if one.when.step is entry.step and one.when.stored is stored]:
            if blow.when.nth == self._steps[entry.step.value, stored]:
                self._due(blow)

    def _due(self, blow: Blow) -> None:
        self._waiting.remove(blow)
        if blow.when.after_s:
            self._arena.later(blow.when.after_s, lambda: self._strike(blow))
        else:
            self._strike(blow)

    def _strike(self, blow: Blow) -> None:
        self._seen.note_blow(blow.model_copy(update={"kind": name_of(blow.kind, blow.options)}))
        BLOWS[blow.kind](self._arena, blow.options)
