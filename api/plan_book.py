"""Plans as resources: what was asked, how far it is, and what came out. Kept in memory."""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import dataclass, field
from typing import Any

import structlog
from pydantic import BaseModel

from api.events import EventLog
from api.problems import ConflictError, NotFoundError
from api.solver import Job, Solver
from planner import Cause, Plan, PlanStatus, ReplanError, Scenario

log = structlog.get_logger()
ENDED = {PlanStatus.SUCCEEDED, PlanStatus.INFEASIBLE, PlanStatus.CANCELLED, PlanStatus.FAILED, PlanStatus.INTERRUPTED}


class UnfinishedPlan(BaseModel):
    """A plan that has no result (yet): the fields of a plan that are known, and the error if it failed."""

    id: str
    revision: int
    status: PlanStatus
    cause: Cause
    parent: str | None
    scenario: Scenario | None
    error: str | None = None


@dataclass
class PlanRecord:
    """One plan resource."""

    id: str
    job: Job
    revision: int
    cause: Cause
    parent: str | None
    token: int
    status: PlanStatus = PlanStatus.QUEUED
    result: Plan | None = None
    error: str | None = None
    done: asyncio.Event = field(default_factory=asyncio.Event)

    def view(self) -> Plan | UnfinishedPlan:
        """What the client sees."""
        if self.result is not None:
            return self.result
        scenario = self.job.scenario or (self.job.previous.scenario if self.job.previous else None)
        return UnfinishedPlan(
            id=self.id,
            revision=self.revision,
            status=self.status,
            cause=self.cause,
            parent=self.parent,
            scenario=scenario,
            error=self.error,
        )


class PlanBook:
    """All plans of this service, newest last."""

    def __init__(self, solver: Solver, events: EventLog) -> None:
        self._solver, self._events = solver, events
        self._records: dict[str, PlanRecord] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def record(self, plan_id: str) -> PlanRecord:
        """The resource. Raises NotFoundError."""
        try:
            return self._records[plan_id]
        except KeyError:
            raise NotFoundError(f"plan {plan_id!r} does not exist") from None

    def finished(self, plan_id: str) -> Plan:
        """The plan itself. Raises NotFoundError, or ConflictError while it has no result."""
        record = self.record(plan_id)
        if record.result is None:
            raise ConflictError(f"plan {plan_id!r} is {record.status.value} and has no result to use")
        return record.result

    def submit(self, scenario: Scenario, deadline_s: float | None = None) -> PlanRecord:
        """Queue a plan for `scenario`."""
        return self._start(Job(scenario=scenario, deadline_s=deadline_s), Cause(), revision=1, parent=None)

    def submit_replan(
        self, plan_id: str, request: dict[str, Any], cause: Cause, deadline_s: float | None = None
    ) -> PlanRecord:
        """Queue a replan of a finished plan; `request` holds arguments of `planner.replan`."""
        previous = self.finished(plan_id)
        job = Job(previous=previous, request={**request, "cause": cause}, deadline_s=deadline_s)
        return self._start(job, cause, revision=previous.revision + 1, parent=plan_id)

    def cancel(self, plan_id: str) -> PlanRecord:
        """Ask a running plan to return the best it has; a finished one stays as it is."""
        record = self.record(plan_id)
        if record.status not in ENDED:
            self._solver.stop(record.token)
        return record

    async def wait(self, record: PlanRecord, seconds: float) -> bool:
        """Wait until the plan has ended, at most that long; whether it has."""
        try:
            async with asyncio.timeout(seconds):
                await record.done.wait()
        except TimeoutError:
            return False
        return True

    async def close(self) -> None:
        """Ask every running solve to stop and forget those that wait."""
        for record in self._records.values():
            if record.status not in ENDED:
                self._solver.stop(record.token)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _start(self, job: Job, cause: Cause, *, revision: int, parent: str | None) -> PlanRecord:
        token = self._solver.reserve()
        plan_id = f"plan-{secrets.token_hex(6)}"
        record = PlanRecord(plan_id, job, revision, cause, parent, token)
        record.job.identity["id"] = plan_id
        self._records[plan_id] = record
        task = asyncio.create_task(self._solve(record))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return record

    async def _solve(self, record: PlanRecord) -> None:
        def running() -> None:
            record.status = PlanStatus.RUNNING

        try:
            record.result = await self._solver.solve(record.job, record.token, running)
            record.status = record.result.status
        except (ReplanError, ValueError) as error:
            record.status, record.error = PlanStatus.INFEASIBLE, str(error)
        except asyncio.CancelledError:
            record.status, record.error = PlanStatus.INTERRUPTED, "the service was stopped"
            raise
        except Exception as error:
            log.exception("solve failed", plan_id=record.id)
            record.status, record.error = PlanStatus.FAILED, f"{type(error).__name__}: {error}"
        finally:
            record.done.set()
            self._events.add("plan_ended", plan_id=record.id, status=record.status.value, error=record.error)
