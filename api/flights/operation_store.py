"""The stored part of one operation: its row, and the track of its flight."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import bindparam, insert, update

from skyfolio.api.common.surroundings import monotonic_s, utc_s
from skyfolio.api.flights.journal import Journal
from skyfolio.api.flights.operation_views import ENDED, Policy, State
from skyfolio.api.flights.track import Track
from skyfolio.api.store import Database
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.tables import operations as table
from skyfolio.api.store.tables import plans as plans_table
from skyfolio.api.store.tables import track as track_table
from skyfolio.api.store.writer import Statement

TRACK_EVERY_S = 0.5
_INSERT = insert(table)
_TRACK = insert(track_table)
_COLUMNS = ("state", "version", "document", "ended_at")
_UPDATE = (
    update(table)
    .where(table.c.id == bindparam("operation_id"))
    .values({name: bindparam(f"new_{name}") for name in _COLUMNS})
)
_MARK = (
    update(plans_table).where(plans_table.c.id == bindparam("plan_id_")).values(operation_id=bindparam("operation_id_"))
)


@dataclass(kw_only=True)
class OperationIdentity:
    """What identifies an operation and never changes.

    disruption_weight: what a recovery's change of the plan must be worth, kbit/s (`planner.replan`).
    """

    id: str
    number: int
    policy: Policy
    created_at: float = field(default_factory=utc_s)
    fingerprint: str | None = None
    launch_itself: bool = True
    disruption_weight: float = 0.0


@dataclass(frozen=True)
class Stores:
    """Where operations store what they do."""

    database: Database
    journal: Journal
    events: EventLog


class OperationRows:
    """The row of one operation, written whole each time, and its track, of which only the new part is written."""

    def __init__(self, database: Database, identity: OperationIdentity) -> None:
        self._database, self._identity = database, identity
        self.saved: asyncio.Future[None] | None = None
        """Done when the newest state is durable; None before the first save."""
        self._marked: set[str] = set()
        self._tracked = 0
        self._tracked_at = 0.0

    async def create(
        self, plan_id: str, state: State, document: dict[str, Any], claim: Sequence[Statement] = ()
    ) -> None:
        """Store a new operation, and with it its claim to its vehicles. Raises StoreError."""
        identity = self._identity
        row = {
            **{name: getattr(identity, name) for name in ("id", "number", "created_at", "fingerprint", "policy")},
            "plan_id": plan_id,
            **_values(state, 0, document),
        }
        await self._database.write((_INSERT, row), *claim, *self._flown([plan_id]))

    async def save(self, state: State, version: int, document: dict[str, Any]) -> None:
        """Store the operation as it is now. The flight goes on if the database does not answer."""
        await self._database.kept(self.save_soon(state, version, document))

    def save_soon(self, state: State, version: int, document: dict[str, Any]) -> asyncio.Future[None]:
        """Begin to store the operation as it is now; return what is done when it is durable."""
        row = {f"new_{name}": value for name, value in _values(state, version, document).items()}
        flown = self._flown([entry["plan_id"] for name in ("timeline", "serving") for entry in document[name]])
        statement = (_UPDATE, {"operation_id": self._identity.id, **row})
        owned = self._database.owned(self._identity.id)
        self.saved = self._database.write_soon(*owned, statement, *flown, keep=True)
        return self.saved

    def _flown(self, plan_ids: Sequence[str]) -> list[Statement]:
        """Return statements that mark plans as flown by this operation, each once."""
        new = [plan_id for plan_id in plan_ids if plan_id not in self._marked]
        self._marked.update(new)
        return [(_MARK, {"operation_id_": self._identity.id, "plan_id_": plan_id}) for plan_id in new]

    @property
    def track_is_due(self) -> bool:
        """Return whether TRACK_EVERY_S wall seconds have passed since the track was last stored."""
        return monotonic_s() - self._tracked_at >= TRACK_EVERY_S

    def write_track(self, record: Track) -> None:
        """Store what is new of the record."""
        self._tracked_at = monotonic_s()
        new = record.since(self._tracked)
        self.has_track_of(record)
        if new:
            rows = [
                {"operation_id": self._identity.id, "elapsed_s": at_s, "positions": json.dumps(positions_m)}
                for at_s, positions_m in new
            ]
            self._database.write_soon(*self._database.owned(self._identity.id), (_TRACK, rows), keep=True)

    def has_track_of(self, record: Track) -> None:
        """Note that this record is stored already."""
        self._tracked = record.end


def _values(state: State, version: int, document: dict[str, Any]) -> dict[str, Any]:
    return {
        "state": state.value,
        "version": version,
        "document": json.dumps(document),
        "ended_at": utc_s() if state in ENDED else None,
    }
