"""Retention: when ended plans, ended operations with all their rows, events and audit rows are deleted.

Rows are selected by column and deleted in small steps, so that neither the event loop nor a flight's writes wait.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import structlog
from sqlalchemy import Table, delete, func, select

from skyfolio.api.common.settings import Settings
from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.store import Database
from skyfolio.api.store.tables import audit, drills, events, operations, plans

log = structlog.get_logger()
AT_ONCE = 2_000
"""Rows deleted in one transaction."""


class Retention:
    """Keeps the database from growing without end. `wall_s`: UTC seconds."""

    def __init__(self, database: Database, settings: Settings, *, wall_s: Callable[[], float] = utc_s) -> None:
        self._database, self._settings, self._wall_s = database, settings, wall_s

    async def tidy(self, forget_plans: Callable[[float], Awaitable[int]]) -> dict[str, int]:
        """Delete what is old or too much. Return how many rows of each kind. Raises StoreError.

        forget_plans: deletes plans that ended before that UTC second and that no operation flew.
        """
        now, settings = self._wall_s(), self._settings
        counts = {
            "operations": await self._forget_operations(now - settings.keep_operations_s),
            "plans": await forget_plans(now - settings.keep_ended_s),
            "events": await self._forget(events, now - settings.keep_events_s, settings.keep_events),
            "audit": await self._forget(audit, now - settings.keep_audit_s, settings.keep_audit),
        }
        if any(counts.values()):
            log.info("forgotten", **counts)
            await self._database.shrink()
        return counts

    async def _forget(self, table: Table, before: float, most: int) -> int:
        """Delete rows from before that UTC second, and the oldest beyond `most`; `id` grows with time.

        The newest one stays: the next number is counted from it.
        """
        newest = (await self._database.rows(select(func.max(table.c.id))))[0][0] or 0
        count = 0
        while True:
            old = ((table.c.at < before) & (table.c.id < newest)) | (table.c.id <= newest - most)
            ids = [row.id for row in await self._database.rows(select(table.c.id).where(old).limit(AT_ONCE))]
            if not ids:
                return count
            await self._database.write(delete(table).where(table.c.id.in_(ids)))
            count += len(ids)

    async def _forget_operations(self, before: float) -> int:
        """Delete operations that ended before that second, with their journals, tracks, missions, plans and drills."""
        old = select(operations.c.id).where(operations.c.ended_at < before)
        ids = [row.id for row in await self._database.rows(old.limit(AT_ONCE))]
        for operation_id in ids:  # each in a transaction of its own: a long flight has many rows
            await self._database.write(
                delete(drills).where(drills.c.operation_id == operation_id),
                delete(plans).where(plans.c.operation_id == operation_id),
                delete(operations).where(operations.c.id == operation_id),
            )
        return len(ids)
