"""How far ahead an operation without a fixed end is planned, and when that has to be extended."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import Any

from pydantic import BaseModel

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.endless.terms import LEAST_LEFT_SLOTS, End, Terms
from skyfolio.api.flights.flight_timeline import FlightTimeline

KEPT_HORIZONS, LEAST_KEPT_SLOTS = 3, 60
"""Rates and places of so many horizons, and at least of so many slots, are kept in memory."""


class EndlessView(BaseModel):
    """How an operation without a fixed end is extended.

    `planned_slots`: how many slots are planned so far; without a further extension the missions end then. `end_slot`:
    when it is to end, in slots; None for never. `duration_s`: in fleet seconds since slot 0; `until`: as a time.
    `extensions`: how often it was extended.
    """

    horizon_slots: int
    replan_every_slots: int
    planned_slots: int
    end_slot: int | None
    duration_s: float | None
    until: datetime | None
    extensions: int


class Horizon:
    """The horizon of one flight. Slots are those of the operation."""

    def __init__(self, terms: Terms, timeline: FlightTimeline, clock: FleetClock) -> None:
        self.terms, self.extensions = terms, 0
        self._timeline, self._clock = timeline, clock

    @property
    def kept_slots(self) -> int:
        """Return of how many of the last slots rates and places are kept in memory."""
        return max(KEPT_HORIZONS * self.terms.horizon_slots, LEAST_KEPT_SLOTS)

    def end_slot(self) -> int | None:
        """Return how many slots the operation shall have at most; None where it has no end."""
        end, slot_s = self.terms.end, self._timeline.slot_s
        if end.duration_s is not None:
            return int(end.duration_s // slot_s)
        if end.until_utc_s is not None:
            left_s = -self._clock.since_utc(end.until_utc_s)
            return max(0, int((self._timeline.now_s() + left_s) // slot_s))
        return None

    def slots_from(self, at_slot: int, *, tried: int = 0) -> int:
        """Return how many slots a plan from `at_slot` on shall have: those planned already, or up to the horizon.

        tried: how many plans were refused before; each time half as many more are asked for.
        """
        planned, end = self._timeline.n_slots - at_slot, self.end_slot()
        wanted = self.terms.horizon_slots if end is None else min(self.terms.horizon_slots, end - at_slot)
        return planned + (max(wanted - planned, 0) >> tried)

    def is_due(self) -> bool:
        """Return whether the plan in force has to be replaced by one that reaches further."""
        slot, end, planned = self._timeline.slot(), self.end_slot(), self._timeline.n_slots
        if slot is None or (end is not None and planned >= end):
            return False
        left = max(self.terms.horizon_slots - self.terms.replan_every_slots, LEAST_LEFT_SLOTS)
        return planned - (slot + 1) <= left

    def move_end(self, end: End) -> None:
        """Let the operation end then; what is planned already is flown in any case."""
        self.terms = replace(self.terms, end=end)

    def view(self) -> EndlessView:
        """Return what clients see."""
        terms = self.terms
        return EndlessView(
            horizon_slots=terms.horizon_slots,
            replan_every_slots=terms.replan_every_slots,
            planned_slots=self._timeline.n_slots,
            end_slot=self.end_slot(),
            duration_s=terms.end.duration_s,
            until=None if terms.end.until_utc_s is None else datetime.fromtimestamp(terms.end.until_utc_s, UTC),
            extensions=self.extensions,
        )

    def document(self) -> dict[str, Any]:
        """Return what a restart needs."""
        return {**asdict(self.terms), "extensions": self.extensions}


def terms_in(document: dict[str, Any]) -> tuple[Terms, int]:
    """Return the terms that `Horizon.document` stored, and how often the operation was extended."""
    fields = {**document, "end": End(**document["end"])}
    extensions = fields.pop("extensions")
    return Terms(**fields), extensions
