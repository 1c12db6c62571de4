"""Plans as resources: request, progress and result. All are stored; recent ones are also in memory."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import structlog

from skyfolio.api.common.errors import ConflictError, NotFoundError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.plans.job_board import Progress
from skyfolio.api.plans.jobs import Job
from skyfolio.api.plans.plan_records import Asked, PlanRecord, UnfinishedPlan
from skyfolio.api.plans.plan_store import PlanStore
from skyfolio.api.plans.solver import LaneName, SolveError, Solver
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.numbers import Numbers
from skyfolio.planner import Cause, Pins, Plan, PlanStatus, Scenario

log = structlog.get_logger()
KEEP_IN_MEMORY = 256


class PlanBook:
    """All plans of this service."""

    def __init__(self, solver: Solver, events: EventLog, store: PlanStore, settings: Settings) -> None:
        self._solver, self._events, self.store = solver, events, store
        self._deadline_s, self._most_starts = settings.solve_deadline_s, settings.plan_starts
        self._active: dict[str, PlanRecord] = {}
        self._recent: OrderedDict[str, PlanRecord] = OrderedDict()
        self._tasks: set[asyncio.Task[None]] = set()
        self._numbers = Numbers()
        self.on_solved: Callable[[str, float, int], None] = lambda kind, seconds, iterations: None  # noqa: ARG005
        """Called after each solve: plan or replan, seconds in the optimiser, iterations."""

    async def start(self) -> None:
        """Take over what the last process left: solves it did not finish end as `interrupted`."""
        self._numbers = Numbers(await self.store.last_number(), several=self.store.service is not None)
        for plan_id in await self.store.unended():
            error = "the service was stopped before the plan was finished"
            await self.store.interrupt(plan_id, error)
            self._events.add("plan_ended", plan_id=plan_id, status=PlanStatus.INTERRUPTED.value, error=error)

    async def record(self, plan_id: str) -> PlanRecord:
        """Return the resource. Raises NotFoundError."""
        record = self._active.get(plan_id) or self._recent.get(plan_id) or await self._load(plan_id)
        if record is None:
            raise NotFoundError(f"plan {plan_id!r} does not exist")
        return record

    async def result(self, plan_id: str) -> str:
        """Return the plan as JSON, without reading it. Raises as `finished` does."""
        record = await self.record(plan_id)
        if record.result is None:
            raise ConflictError(f"plan {plan_id!r} is {record.status.value} and has no result to use")
        return record.result

    async def finished(self, plan_id: str) -> Plan:
        """Return the plan itself. Raises NotFoundError, or ConflictError while it has no result."""
        record = await self.record(plan_id)
        if record.plan is None:
            raise ConflictError(f"plan {plan_id!r} is {record.status.value} and has no result to use")
        return record.plan

    # -- making and ending them -----------------------------------------------------------------------------------

    async def submit(
        self,
        scenario: Scenario,
        creation: NewResource,
        deadline_s: float | None = None,
        starts: int | None = None,
        *,
        pins: Pins | None = None,
    ) -> PlanRecord:
        """Queue a plan for `scenario`. Raises BusyError; returns the same resource for the same Idempotency-Key."""
        if existing := await self._made_before(creation):
            return existing
        text = scenario.model_dump_json()
        job = Job(
            scenario=text,
            request={"pins": pins},
            deadline_s=deadline_s or self._deadline_s,
            starts=starts,
            most_starts=self._most_starts,
        )
        return self._start(
            job,
            creation,
            LaneName.REQUESTS,
            cause=Cause(),
            revision=1,
            parent=None,
            scenario=text,
            asked=Asked(pins=pins or Pins()),
        )

    async def submit_replan(
        self,
        previous: Plan,
        request: dict[str, Any],
        cause: Cause,
        creation: NewResource,
        *,
        deadline_s: float | None = None,
        lane: LaneName = LaneName.REQUESTS,
    ) -> PlanRecord:
        """Queue a replan of a finished plan; `request` holds arguments of `planner.replan`. Raises BusyError."""
        if existing := await self._made_before(creation):
            return existing
        job = Job(previous=previous.model_dump_json(), request=request, deadline_s=deadline_s or self._deadline_s)
        return self._start(
            job,
            creation,
            lane,
            cause=cause,
            revision=previous.revision + 1,
            parent=previous.id,
            scenario=previous.scenario.model_dump_json(),
            asked=Asked.model_validate({name: request[name] for name in Asked.model_fields if name in request}),
        )

    async def reassociated(self, previous: Plan, request: dict[str, Any], cause: Cause, plan_id: str) -> Plan:
        """Return a finished plan whose users are served anew, at once and on its own paths; it is not stored.

        request: arguments of `planner.reassociate`. Raises BusyError, SolveError.
        """
        identity = {"id": plan_id, "cause": cause.model_dump(mode="json")}
        job = Job(task="reassociate", previous=previous.model_dump_json(), request=request, identity=identity)
        return Plan.model_validate_json((await self._solver[LaneName.FLIGHT].solve(job)).plan)

    async def adopt(self, plan: Plan, creation: NewResource) -> Plan:
        """Store a plan that was made ahead of time, under a new id. Durable when it returns."""
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
        await self.store.add_ended(record, plan.summary.model_dump_json())
        self._remember(record)
        self._events.add("plan_ended", plan_id=record.id, status=record.status.value, error=None)
        return plan

    async def cancel(self, plan_id: str) -> PlanRecord:
        """Ask a running plan to return the best result it has; an ended one stays as it is.

        Raises NotFoundError, and ConflictError for one that another service is making.
        """
        record = await self.record(plan_id)
        if _is_made_elsewhere(record):
            raise ConflictError(f"plan {plan_id!r} is being made by another service: cancel it there")
        if not record.ended:
            self._solver[record.lane].stop(record.token)
        return record

    async def wait(self, record: PlanRecord, seconds: float) -> bool:
        """Wait at most that many seconds until the plan has ended. Return whether it has."""
        if record.done.is_set() or seconds <= 0:
            return record.done.is_set()
        try:
            async with asyncio.timeout(seconds):
                await record.done.wait()
        except TimeoutError:
            return False
        return True

    async def text(self, record: PlanRecord) -> str:
        """Return the plan as JSON; while it has no result, what is known of it and the best plan so far."""
        best = await self._best_so_far(record)
        if record.result is not None:
            return record.result
        known = UnfinishedPlan(
            id=record.id,
            revision=record.revision,
            status=record.status,
            cause=record.cause,
            parent=record.parent,
            scenario=Scenario.model_validate_json(record.scenario),
            progress=self._progress(record),
            error=record.error,
            **{name: getattr(record.asked, name) for name in Asked.model_fields},
        )
        return f'{known.model_dump_json(exclude={"best"})[:-1]},"best":{best or "null"}}}'

    def _progress(self, record: PlanRecord) -> Progress | None:
        if record.ended or _is_made_elsewhere(record):
            return None
        return self._solver[record.lane].progress(record.token)

    async def _best_so_far(self, record: PlanRecord) -> str | None:
        lane = self._solver[record.lane]
        if record.ended or _is_made_elsewhere(record) or not lane.running(record.token):
            return None
        record.status = PlanStatus.RUNNING
        return await lane.best(record.token, record.id)

    async def forget_ended(self, before: float) -> int:
        """Delete plans that ended before that UTC second and that no operation flew. Return how many."""
        forgotten = await self.store.forget_ended(before)
        for plan_id in forgotten:
            self._recent.pop(plan_id, None)
        return len(forgotten)

    async def close(self) -> None:
        """Ask every running solve to stop and cancel those that wait: they end as `interrupted`."""
        for record in self._active.values():
            self._solver[record.lane].stop(record.token)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _made_before(self, creation: NewResource) -> PlanRecord | None:
        if creation.fingerprint is None:
            return None
        record = self._active.get(creation.id) or self._recent.get(creation.id) or await self._load(creation.id)
        record = record or self._active.get(creation.id)  # submitted by a concurrent request meanwhile
        if record is not None:
            creation.require_same(record.fingerprint)
        return record

    def _new(self, creation: NewResource, **fields: Any) -> PlanRecord:
        return PlanRecord(
            id=creation.id,
            number=self._numbers.next(),
            created_at=utc_s(),
            owner=creation.owner,
            fingerprint=creation.fingerprint,
            **fields,
        )

    def _start(self, job: Job, creation: NewResource, lane: LaneName, **fields: Any) -> PlanRecord:
        token = self._solver[lane].reserve()
        record = self._new(creation, lane=lane, token=token, **fields)
        job.identity.update(id=record.id, cause=record.cause.model_dump(mode="json"))
        self._active[record.id] = record
        record.stored = self.store.add(record)
        task = asyncio.create_task(self._solve(record, job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return record

    async def _solve(self, record: PlanRecord, job: Job) -> None:
        try:
            solved = await self._solver[record.lane].solve(job, record.token)
            await self.store.added(record, record.stored)
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
            summary = record.solved.summary if record.solved else None
            await self.store.end(record, summary)
        finally:
            self._active.pop(record.id, None)
            self._remember(record)
            record.done.set()
            self._events.add("plan_ended", plan_id=record.id, status=record.status.value, error=record.error)

    def _remember(self, record: PlanRecord) -> None:
        self._recent[record.id] = record
        while len(self._recent) > KEEP_IN_MEMORY:
            self._recent.popitem(last=False)

    async def _load(self, plan_id: str) -> PlanRecord | None:
        record = await self.store.load(plan_id)
        if record is not None and record.ended:  # else another service is still making it
            self._remember(record)
        return record


def _is_made_elsewhere(record: PlanRecord) -> bool:
    """Return whether a plan has not ended and is not one of this process."""
    return not record.ended and record.token < 0
