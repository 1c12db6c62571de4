"""The journal of operations in the air: each step is stored before it is taken.

    detected -> classified [-> waiting] -> replanned -> checked [-> proposed -> approved]
    -> uploading (per UAV) -> verified (per UAV) -> flying -> closed

From what a killed service has stored the next one learns what was certainly not begun, what was certainly done, and
which commands are in doubt. Commands in doubt are never sent again: the vehicles are asked what they fly.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from pydantic import BaseModel
from sqlalchemy import insert, select

from skyfolio.api.common.surroundings import monotonic_s, utc_now
from skyfolio.api.store import Database
from skyfolio.api.store.tables import journal as table

_INSERT = insert(table)


class Step(StrEnum):
    """What is about to be done, or (verified, flying, closed) has been observed."""

    DETECTED = "detected"
    CLASSIFIED = "classified"
    WAITING = "waiting"
    REPLANNED = "replanned"
    CHECKED = "checked"
    REFUSED = "refused"
    PROPOSED = "proposed"
    APPROVED = "approved"
    UPLOADING = "uploading"
    VERIFIED = "verified"
    FLYING = "flying"
    CLOSED = "closed"


class Entry(BaseModel):
    """One step of an incident.

    `elapsed_s`: fleet seconds since slot 0. `incident` numbers the incidents of an operation.
    """

    operation_id: str
    incident: int
    step: Step
    uav_id: str | None = None
    at: datetime
    elapsed_s: float | None = None
    data: dict[str, Any] = {}


Listener = Callable[[Entry, bool], None]
"""Called with False before an entry is stored, and with True after it."""


class Journal:
    """Appends entries. If the database does not answer, entries are held and the flight goes on."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.listeners: list[Listener] = []

    async def write(self, *entries: Entry) -> None:
        """Store entries in one transaction."""
        for entry in entries:
            self._call_listeners(entry, stored=False)
        operations = {entry.operation_id for entry in entries}
        owned = [statement for operation_id in operations for statement in self._database.owned(operation_id)]
        await self._database.keep(*owned, *((_INSERT, _row(entry)) for entry in entries))
        for entry in entries:
            self._call_listeners(entry, stored=True)

    async def of(self, operation_id: str) -> list[Entry]:
        """Return every entry of one operation, the oldest first."""
        query = select(table).where(table.c.operation_id == operation_id).order_by(table.c.id)
        return [entry_of(row) for row in await self._database.rows(query)]

    def _call_listeners(self, entry: Entry, *, stored: bool) -> None:
        for listener in self.listeners:
            listener(entry, stored)


class IncidentLog:
    """Writes the steps of one incident, and knows how far it is."""

    def __init__(self, journal: Journal, operation_id: str, number: int, elapsed_s: Callable[[], float]) -> None:
        self._journal, self._operation_id, self.number, self._elapsed_s = journal, operation_id, number, elapsed_s
        self.sending = False
        """Whether anything may have reached a vehicle."""
        self.closed = False
        """Whether the last step is written, or is being written."""
        self.timings_s: dict[str, float] = {}
        self._last = (Step.DETECTED, monotonic_s())

    @property
    def may_be_broken_off(self) -> bool:
        """Return whether nothing has been sent, and the last step is not being written."""
        return not self.sending and not self.closed

    async def step(self, step: Step, **data: Any) -> None:
        """Store that `step` is about to be taken."""
        self._time(step)
        self.closed = self.closed or step is Step.CLOSED
        await self._journal.write(self._entry(step, None, data))

    async def step_each(self, step: Step, data: dict[str, dict[str, Any]]) -> None:
        """Store that `step` is about to be taken for each of these UAVs."""
        self._time(step)
        self.sending = self.sending or step is Step.UPLOADING
        await self._journal.write(*(self._entry(step, uav, uav_data) for uav, uav_data in data.items()))

    def _entry(self, step: Step, uav_id: str | None, data: dict[str, Any]) -> Entry:
        return Entry(
            operation_id=self._operation_id,
            incident=self.number,
            step=step,
            uav_id=uav_id,
            at=utc_now(),
            elapsed_s=round(self._elapsed_s(), 3),
            data=data,
        )

    def _time(self, step: Step) -> None:
        """Add up the wall seconds from each step to the next one of another kind."""
        last, began_s = self._last
        if step is not last:
            now_s = monotonic_s()
            self.timings_s[last.value] = round(self.timings_s.get(last.value, 0.0) + now_s - began_s, 4)
            self._last = (step, now_s)


def last_incident(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries of the newest incident."""
    newest = max((entry.incident for entry in entries), default=0)
    return [entry for entry in entries if entry.incident == newest]


def _row(entry: Entry) -> dict[str, Any]:
    return {
        "operation_id": entry.operation_id,
        "incident": entry.incident,
        "step": entry.step.value,
        "uav_id": entry.uav_id,
        "at": entry.at.timestamp(),
        "elapsed_s": entry.elapsed_s,
        "data": json.dumps(entry.data),
    }


def entry_of(row: Any) -> Entry:
    """Return the entry in a row of the table."""
    return Entry(
        operation_id=row.operation_id,
        incident=row.incident,
        step=row.step,
        uav_id=row.uav_id,
        at=datetime.fromtimestamp(row.at, UTC),
        elapsed_s=row.elapsed_s,
        data=json.loads(row.data),
    )
