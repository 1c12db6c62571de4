"""Plans in the database: written when requested and when they end, read when they are no longer in memory."""

from __future__ import annotations

import asyncio
from typing import Any

from sqlalchemy import Row, bindparam, delete, func, select, update

from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.plans.plan_records import Asked, PlanRecord
from skyfolio.api.plans.solver import LaneName
from skyfolio.api.store import Database
from skyfolio.api.store.tables import plans as table
from skyfolio.planner import Cause, PlanStatus

FORGET_AT_ONCE = 500
_INSERT = table.insert()
_END = (
    update(table)
    .where(table.c.id == bindparam("plan_id"))
    .values({name: bindparam(f"new_{name}") for name in ("status", "ended_at", "summary", "result", "error")})
)


class PlanStore:
    """The table of plans."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def last_number(self) -> int:
        """Return how many plans there have been."""
        return (await self._database.rows(select(func.max(table.c.number))))[0][0] or 0

    @property
    def service(self) -> str | None:
        """Return the name of this service where several share the database, else None."""
        return None if self._database.leases is None else self._database.leases.name

    async def unended(self) -> list[str]:
        """Return the ids of plans that were queued or running, at this service, when they were last written."""
        query = select(table.c.id).where(table.c.status.in_([PlanStatus.QUEUED, PlanStatus.RUNNING]))
        if self.service is not None:
            query = query.where(table.c.service.is_(None) | (table.c.service == self.service))
        return [row.id for row in await self._database.rows(query)]

    def add(self, record: PlanRecord) -> asyncio.Future[None]:
        """Store a new plan; `added` waits for it."""
        return self._database.write_soon((_INSERT, self._row(record)), keep=_is_a_flights(record))

    async def added(self, record: PlanRecord, stored: asyncio.Future[None]) -> None:
        """Wait until a new plan is durable. A flight's waits only while the database answers; others: StoreError."""
        await (self._database.kept(stored) if _is_a_flights(record) else stored)

    async def add_ended(self, record: PlanRecord, summary: str) -> None:
        """Store a plan that a flight takes over, with its result; held while the database does not answer."""
        ended = {"ended_at": utc_s(), "summary": summary, "result": record.result}
        await self._database.keep((_INSERT, self._row(record) | ended))

    async def interrupt(self, plan_id: str, error: str) -> None:
        """Store that a plan was not finished, and why. Raises StoreError."""
        row = {**dict.fromkeys(("new_summary", "new_result")), "new_status": PlanStatus.INTERRUPTED.value}
        await self._database.write((_END, {**row, "plan_id": plan_id, "new_ended_at": utc_s(), "new_error": error}))

    async def end(self, record: PlanRecord, summary: str | None) -> None:
        """Store how a plan ended; held while the database does not answer."""
        row = {
            "plan_id": record.id,
            "new_status": record.status.value,
            "new_ended_at": utc_s(),
            "new_summary": summary,
            "new_result": record.result,
            "new_error": record.error,
        }
        await self._database.keep((_END, row))

    def _row(self, record: PlanRecord) -> dict[str, Any]:
        return {**_row(record), "service": self.service}

    async def load(self, plan_id: str) -> PlanRecord | None:
        """Return the plan as it was stored."""
        rows = await self._database.rows(select(table).where(table.c.id == plan_id))
        if not rows:
            return None
        row = rows[0]
        record = PlanRecord(
            id=row.id,
            number=row.number,
            created_at=row.created_at,
            owner=row.owner,
            fingerprint=row.fingerprint,
            revision=row.revision,
            cause=Cause.model_validate_json(row.cause),
            parent=row.parent,
            scenario=row.scenario,
            asked=Asked() if row.asked is None else Asked.model_validate_json(row.asked),
            status=PlanStatus(row.status),
            result=row.result,
            error=row.error,
        )
        record.done.set()
        return record

    async def rows(self, limit: int, before: int | None = None, status: PlanStatus | None = None) -> list[Row[Any]]:
        """Return the newest plans (older than number `before`), without their results."""
        columns = [column for column in table.c if column.name not in {"scenario", "asked", "result"}]
        query = select(*columns).order_by(table.c.number.desc()).limit(limit)
        if before is not None:
            query = query.where(table.c.number < before)
        if status is not None:
            query = query.where(table.c.status == status)
        return list(await self._database.rows(query))

    async def forget_ended(self, before: float) -> list[str]:
        """Delete plans that ended before that UTC second and that no operation flew; their ids."""
        old = select(table.c.id).where(table.c.ended_at < before, table.c.operation_id.is_(None))
        ids = [row.id for row in await self._database.rows(old)]
        for start in range(0, len(ids), FORGET_AT_ONCE):
            batch = ids[start : start + FORGET_AT_ONCE]
            await self._database.write(delete(table).where(table.c.id.in_(batch)))
        return ids


def _is_a_flights(record: PlanRecord) -> bool:
    return record.lane is LaneName.FLIGHT


def _row(record: PlanRecord) -> dict[str, Any]:
    return {
        "id": record.id,
        "number": record.number,
        "created_at": record.created_at,
        "owner": record.owner,
        "fingerprint": record.fingerprint,
        "status": record.status.value,
        "revision": record.revision,
        "parent": record.parent,
        "cause": record.cause.model_dump_json(),
        "scenario": record.scenario,
        "asked": record.asked.model_dump_json(exclude_defaults=True),
    }
