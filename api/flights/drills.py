"""Drills: a fault strikes a simulated vehicle of an operation, now or when a slot begins.

Real vehicles are never struck.
"""

from __future__ import annotations

import asyncio
import json
from enum import StrEnum
from typing import Any, TypeAlias

from pydantic import BaseModel
from sqlalchemy import Row, func, insert, select, update

from skyfolio.api.common.errors import ConflictError, InvalidError, NotFoundError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.fleet.simulated_fleet import SimulatedFleet, fault_of
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import State
from skyfolio.api.flights.operations import Operations
from skyfolio.api.store import Database
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.tables import drills as table

LOOK_EVERY_S = 0.02
DrillOptions: TypeAlias = dict[str, float | int | str | bool | dict[str, float | bool]]
"""The options of a fault by name; `impair` takes one such table for each direction."""


class DrillState(StrEnum):
    """The states of a drill."""

    SCHEDULED = "scheduled"
    STRUCK = "struck"
    MISSED = "missed"


class DrillView(BaseModel):
    """A drill. `at_slot` counts from 0, null is at once; `missed`: the operation ended before."""

    id: str
    state: DrillState
    operation_id: str
    uav_id: str
    fault: str
    at_slot: int | None
    options: DrillOptions = {}
    created_at: float


class Drills:
    """All drills of this service.

    simulated: the fleet that the service simulates itself; None if there is none.
    """

    def __init__(
        self,
        fleet: Fleet,
        operations: Operations,
        events: EventLog,
        database: Database,
        simulated: SimulatedFleet | None,
    ) -> None:
        self._fleet, self._operations, self._events, self._database = fleet, operations, events, database
        self._simulated = simulated
        self._number = 0
        self._tasks: set[asyncio.Task[None]] = set()

    async def start_up(self) -> None:
        """Mark the drills that the last process did not carry out as missed: its simulated fleet ended with it."""
        self._number = (await self._database.rows(select(func.max(table.c.number))))[0][0] or 0
        await self._database.write(
            update(table).where(table.c.state == DrillState.SCHEDULED.value).values(state=DrillState.MISSED.value)
        )

    async def schedule(self, creation: NewResource, drill: DrillView) -> DrillView:
        """Schedule a drill.

        Raises InvalidError, NotFoundError, and ConflictError for vehicles that are not simulated.
        """
        if creation.fingerprint is not None and (earlier := await self._created_before(creation)):
            return earlier
        operation = await self._operations.commanded(drill.operation_id)
        if drill.uav_id not in operation.flight.systems:
            raise InvalidError(f"uav_id: {drill.uav_id!r} does not fly in operation {drill.operation_id}")
        if self._simulated is None or not self._fleet.is_simulated(drill.uav_id):
            raise ConflictError(f"uav_id: {drill.uav_id!r} is not simulated by this service; drills need one that is")
        if drill.at_slot is not None and not 0 <= drill.at_slot < operation.flight.n_slots:
            raise InvalidError(f"at_slot: {drill.at_slot} must lie in 0..{operation.flight.n_slots - 1}")
        system_id, joined = self._fleet.system_of(drill.uav_id), self._simulated.stations
        fault = fault_of(drill.fault, system_id, drill.options, stations=joined)
        await self._store(creation, drill)
        self._events.add("drill", **drill.model_dump(mode="json"))
        task = asyncio.create_task(self._strike(drill, operation, self._simulated, fault))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return drill

    async def get(self, drill_id: str) -> DrillView:
        """Return one drill. Raises NotFoundError."""
        rows = await self._database.rows(select(table).where(table.c.id == drill_id))
        if not rows:
            raise NotFoundError(f"drill {drill_id!r} does not exist")
        return _view(rows[0])

    async def page(self, limit: int, before: int | None) -> tuple[list[DrillView], int | None]:
        """Return the newest drills (older than number `before`), and where the next page begins."""
        query = select(table).order_by(table.c.number.desc()).limit(limit + 1)
        rows = await self._database.rows(query if before is None else query.where(table.c.number < before))
        return [_view(row) for row in rows[:limit]], rows[limit - 1].number if len(rows) > limit else None

    async def close(self) -> None:
        """Cancel the drills that have not struck."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _strike(self, drill: DrillView, operation: Operation, simulated: SimulatedFleet, fault: Any) -> None:
        while not _due(drill, operation):
            if self._operations.active(operation.id) is None:
                await self._end(drill, DrillState.MISSED)
                return
            await asyncio.sleep(LOOK_EVERY_S)
        simulated.inject(fault)
        await self._end(drill, DrillState.STRUCK)

    async def _end(self, drill: DrillView, state: DrillState) -> None:
        await self._database.write(update(table).where(table.c.id == drill.id).values(state=state.value))
        self._events.add("drill", **drill.model_copy(update={"state": state}).model_dump(mode="json"))

    async def _store(self, creation: NewResource, drill: DrillView) -> None:
        self._number += 1
        row = {
            "id": drill.id,
            "number": self._number,
            "created_at": drill.created_at,
            "fingerprint": creation.fingerprint,
            "operation_id": drill.operation_id,
            "state": drill.state.value,
            "document": drill.model_dump_json(),
        }
        await self._database.write((insert(table), row))

    async def _created_before(self, creation: NewResource) -> DrillView | None:
        rows = await self._database.rows(select(table).where(table.c.id == creation.id))
        if not rows:
            return None
        creation.require_same(rows[0].fingerprint)
        return _view(rows[0])


def new_drill(creation: NewResource, **fields: Any) -> DrillView:
    """Return a drill that is not stored yet."""
    return DrillView(id=creation.id, state=DrillState.SCHEDULED, created_at=utc_s(), **fields)


def _due(drill: DrillView, operation: Operation) -> bool:
    if drill.at_slot is None:
        return True
    in_the_air = operation.state in {State.FLYING, State.LANDING} and operation.flight.elapsed_s() is not None
    return in_the_air and operation.flight.now_s() >= drill.at_slot * operation.flight.slot_s


def _view(row: Row[Any]) -> DrillView:
    return DrillView.model_validate({**json.loads(row.document), "state": row.state})
