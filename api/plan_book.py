"""Plans as resources: what was asked, how far it is, and what came out. Stored; recent ones are also in memory."""

from __future__ import annotations

import asyncio
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import structlog
from pydantic import BaseModel
from sqlalchemy import Row, bindparam, delete, func, select, update

from api.creation import Creation
from api.errors import ConflictError, NotFoundError
from api.events import EventLog
from api.settings import Settings
from api.solver import Job, LaneName, Progress, Solved, SolveError, Solver
from api.store import Database
from api.store.tables import operations
from api.store.tables import plans as table
from planner import Cause, Plan, PlanStatus, Scenario, Summary

log = structlog.get_logger()
ENDED = {PlanStatus.SUCCEEDED, PlanStatus.INFEASIBLE, PlanStatus.CANCELLED, PlanStatus.FAILED, PlanStatus.INTERRUPTED}
KEEP_IN_MEMORY = 256
_INSERT = table.insert()
_END = (
    update(table)
    .where(table.c.id == bindparam("plan_id"))
    .values({name: bindparam(f"new_{name}") for name in ("status", "ended_at", "summary", "result", "error")})
)


class UnfinishedPlan(BaseModel):
    """A plan that has no result (yet): the fields of a plan that are known, how far it is, and why it failed."""

    id: str
    revision: int
    status: PlanStatus
    cause: Cause
    parent: str | None
    scenario: Scenario | None
    progress: Progress | None = None
    error: str | None = None


class PlanRow(BaseModel):
    """A line of the list of plans. Times are UTC seconds since 1970."""

    id: str
    status: PlanStatus
    revision: int
    parent: str | None
    cause: Cause
    created_at: float
    ended_at: float | None
    summary: Summary | None
    error: str | None


@dataclass
class PlanRecord:
    """One plan resource. `result` is the plan as JSON."""

    id: str
    number: int
    created_at: float
    owner: str
    revision: int
    cause: Cause
    parent: str | None
    scenario: str
    fingerprint: str | None = None
    status: PlanStatus = PlanStatus.QUEUED
    result: str | None = None
    error: str | None = None
    lane: LaneName = LaneName.REQUESTS
    token: int = -1
    solved: Solved | None = None
    stored: asyncio.Future[None] = field(default_factory=lambda: _already())  # noqa: PLW0108 - defined below
    done: asyncio.Event = field(default_factory=asyncio.Event)
    _plan: Plan | None = None

    @property
    def plan(self) -> Plan | None:
        """The result, None while there is none."""
        if self._plan is None and self.result is not None:
            self._plan = Plan.model_validate_json(self.result)
        return self._plan


class PlanBook:
    """All plans of this service."""

    def __init__(self, solver: Solver, events: EventLog, database: Database, settings: Settings) -> None:
        self._solver, self._events, self._database = solver, events, database
        self._deadline_s, self._most_starts = settings.solve_deadline_s, settings.plan_starts
        self._active: dict[str, PlanRecord] = {}
        self._recent: OrderedDict[str, PlanRecord] = OrderedDict()
        self._tasks: set[asyncio.Task[None]] = set()
        self._number = 0
        self.on_solved: Callable[[str, float, int], None] = lambda kind, seconds, iterations: None  # noqa: ARG005
        """Told of each solve: plan or replan, seconds in the optimiser, iterations."""

    async def start(self) -> None:
        """Take over what the last process left: solves it did not finish are `interrupted`."""
        self._number = (await self._database.rows(select(func.max(table.c.number))))[0][0] or 0
        orphans = select(table.c.id).where(table.c.status.in_([PlanStatus.QUEUED, PlanStatus.RUNNING]))
        for row in await self._database.rows(orphans):
            said = "the service was stopped before the plan was finished"
            await self._store_end(row.id, PlanStatus.INTERRUPTED, None, said)
            self._events.add("plan_ended", plan_id=row.id, status=PlanStatus.INTERRUPTED.value, error=said)

    async def record(self, plan_id: str) -> PlanRecord:
        """The resource. Raises NotFoundError."""
        found = self._active.get(plan_id) or self._recent.get(plan_id) or await self._load(plan_id)
        if found is None:
            raise NotFoundError(f"plan {plan_id!r} does not exist")
        return found

    async def finished(self, plan_id: str) -> Plan:
        """The plan itself. Raises NotFoundError, or ConflictError while it has no result."""
        record = await self.record(plan_id)
        if record.plan is None:
            raise ConflictError(f"plan {plan_id!r} is {record.status.value} and has no result to use")
        return record.plan

    async def rows(self, limit: int, before: int | None = None, status: PlanStatus | None = None) -> list[Row[Any]]:
        """The newest plans (older than number `before`), without their results."""
        columns = [column for column in table.c if column.name not in {"scenario", "result"}]
        wanted = select(*columns).order_by(table.c.number.desc()).limit(limit)
        if before is not None:
            wanted = wanted.where(table.c.number < before)
        if status is not None:
            wanted = wanted.where(table.c.status == status)
        return list(await self._database.rows(wanted))

    # -- making and ending them -----------------------------------------------------------------------------------

    async def submit(
        self, scenario: Scenario, creation: Creation, deadline_s: float | None = None, starts: int | None = None
    ) -> PlanRecord:
        """Queue a plan for `scenario`. Raises BusyError; returns the same resource for the same Idempotency-Key."""
        if found := await self._made_before(creation):
            return found
        text = scenario.model_dump_json()
        job = Job(
            scenario=text, deadline_s=deadline_s or self._deadline_s, starts=starts, most_starts=self._most_starts
        )
        return self._start(job, creation, LaneName.REQUESTS, cause=Cause(), revision=1, parent=None, scenario=text)

    async def submit_replan(
        self,
        previous: Plan,
        request: dict[str, Any],
        cause: Cause,
        creation: Creation,
        *,
        deadline_s: float | None = None,
        lane: LaneName = LaneName.REQUESTS,
    ) -> PlanRecord:
        """Queue a replan of a finished plan; `request` holds arguments of `planner.replan`. Raises BusyError."""
        if found := await self._made_before(creation):
            return found
        job = Job(previous=previous.model_dump_json(), request=request, deadline_s=deadline_s or self._deadline_s)
        return self._start(
            job,
            creation,
            lane,
            cause=cause,
            revision=previous.revision + 1,
            parent=previous.id,
            scenario=previous.scenario.model_dump_json(),
        )

    async def adopt(self, plan: Plan, creation: Creation) -> Plan:
        """Store a plan that was made ahead of its need, under a new id. Durable when it returns."""
        plan = plan.model_copy(update={"id": creation.id})
        record = self._new(
            creation,
            cause=plan.cause,
            revision=plan.revision,
            parent=plan.parent,
            scenario=plan.scenario.model_dump_json(),
        )
        record.status, record.result = plan.status, plan.model_dump_json()
        record.done.set()
        row = self._row(record) | {"ended_at": time.time(), "summary": plan.summary.model_dump_json()}
        await self._database.write((_INSERT, row | {"result": record.result}))
        self._remember(record)
        self._events.add("plan_ended", plan_id=record.id, status=record.status.value, error=None)
        return plan

    async def cancel(self, plan_id: str) -> PlanRecord:
        """Ask a running plan to return the best it has; a finished one stays as it is."""
        record = await self.record(plan_id)
        if record.status not in ENDED:
            self._solver[record.lane].stop(record.token)
        return record

    async def wait(self, record: PlanRecord, seconds: float) -> bool:
        """Wait until the plan has ended, at most that long; whether it has."""
        if record.done.is_set() or seconds <= 0:
            return record.done.is_set()
        try:
            async with asyncio.timeout(seconds):
                await record.done.wait()
        except TimeoutError:
            return False
        return True

    def view(self, record: PlanRecord) -> UnfinishedPlan:
        """What the client sees of a plan without a result."""
        lane = self._solver[record.lane]
        under_way = record.status not in ENDED
        if under_way and lane.running(record.token):
            record.status = PlanStatus.RUNNING
        return UnfinishedPlan(
            id=record.id,
            revision=record.revision,
            status=record.status,
            cause=record.cause,
            parent=record.parent,
            scenario=Scenario.model_validate_json(record.scenario),
            progress=lane.progress(record.token) if under_way else None,
            error=record.error,
        )

    async def forget_ended(self, before: float) -> int:
        """Delete plans that ended before that UTC second and that no operation flew; how many."""
        old = select(table.c.id).where(table.c.ended_at < before, table.c.id.not_in(select(operations.c.plan_id)))
        flown = {
            one
            for row in await self._database.rows(select(operations.c.document))
            for one in (entry["plan_id"] for entry in json.loads(row.document).get("timeline", []))
        }
        gone = [row.id for row in await self._database.rows(old) if row.id not in flown]
        for start in range(0, len(gone), 500):
            await self._database.write(delete(table).where(table.c.id.in_(gone[start : start + 500])))
        for plan_id in gone:
            self._recent.pop(plan_id, None)
        return len(gone)

    async def close(self) -> None:
        """Ask every running solve to stop and forget those that wait: they end `interrupted`."""
        for record in self._active.values():
            self._solver[record.lane].stop(record.token)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _made_before(self, creation: Creation) -> PlanRecord | None:
        if creation.fingerprint is None:
            return None
        found = self._active.get(creation.id) or self._recent.get(creation.id) or await self._load(creation.id)
        found = found or self._active.get(creation.id)  # made by a twin while we looked
        if found is not None:
            creation.require_same(found.fingerprint)
        return found

    def _new(self, creation: Creation, **fields: Any) -> PlanRecord:
        self._number += 1
        return PlanRecord(
            id=creation.id,
            number=self._number,
            created_at=time.time(),
            owner=creation.owner,
            fingerprint=creation.fingerprint,
            **fields,
        )

    def _start(self, job: Job, creation: Creation, lane: LaneName, **fields: Any) -> PlanRecord:
        token = self._solver[lane].reserve()
        record = self._new(creation, lane=lane, token=token, **fields)
        job.identity.update(id=record.id, cause=record.cause.model_dump(mode="json"))
        self._active[record.id] = record
        record.stored = self._database.write_soon((_INSERT, self._row(record)))
        task = asyncio.create_task(self._solve(record, job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return record

    async def _solve(self, record: PlanRecord, job: Job) -> None:
        try:
            solved = await self._solver[record.lane].solve(job, record.token)
            await record.stored
            record.status, record.result, record.solved = solved.status, solved.plan, solved
            self.on_solved("replan" if job.previous else "plan", solved.solve_ms / 1e3, solved.iterations)
        except SolveError as error:
            record.status, record.error = error.status, str(error)
        except asyncio.CancelledError:
            record.status, record.error = PlanStatus.INTERRUPTED, "the service was stopped"
            raise
        except Exception as error:
            log.exception("solve failed", plan_id=record.id)
            record.status, record.error = PlanStatus.FAILED, f"{type(error).__name__}: {error}"
        finally:
            await self._end(record)

    async def _end(self, record: PlanRecord) -> None:
        try:
            await self._store_end(record.id, record.status, record.solved, record.error)
        finally:
            self._active.pop(record.id, None)
            self._remember(record)
            record.done.set()
            self._events.add("plan_ended", plan_id=record.id, status=record.status.value, error=record.error)

    def _store_end(
        self, plan_id: str, status: PlanStatus, solved: Solved | None, error: str | None
    ) -> asyncio.Future[None]:
        row = {
            "plan_id": plan_id,
            "new_status": status.value,
            "new_ended_at": time.time(),
            "new_summary": solved.summary if solved else None,
            "new_result": solved.plan if solved else None,
            "new_error": error,
        }
        return self._database.write_soon((_END, row))

    def _row(self, record: PlanRecord) -> dict[str, Any]:
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
        }

    def _remember(self, record: PlanRecord) -> None:
        self._recent[record.id] = record
        while len(self._recent) > KEEP_IN_MEMORY:
            self._recent.popitem(last=False)

    async def _load(self, plan_id: str) -> PlanRecord | None:
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
            status=PlanStatus(row.status),
            result=row.result,
            error=row.error,
        )
        record.done.set()
        self._remember(record)
        return record


def _already() -> asyncio.Future[None]:
    """The future of something that is stored."""
    done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    done.set_result(None)
    return done
