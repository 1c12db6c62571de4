"""Explanations of plans, previews of changes and assessments: solved in the lane of requests, never stored.

A plan does not change once it has ended, so its explanation is kept in memory and made once, however many clients ask.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from contextlib import suppress
from typing import Any

from pydantic import BaseModel

from skyfolio.api.common.errors import BusyError, InvalidError, ServiceError
from skyfolio.api.common.settings import Settings
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.solver import LaneName, SolveError, Solver
from skyfolio.planner import PlanStatus

KEEP_IN_MEMORY = 64
ASSESS_S = 20.0
"""At most so long is computed for an assessment by default; the setting `solve_deadline_s` may be shorter."""
PREVIEW_S = 10.0
"""At most so long is solved for a preview by default; the setting `solve_deadline_s` may be shorter."""
Key = tuple[str, int]
"""A plan's id, and how many resolves its explanation may take."""


class UnfinishedExplanation(BaseModel):
    """An explanation that is still being made."""

    plan_id: str
    status: PlanStatus = PlanStatus.RUNNING


class Explanations:
    """All explanations of this service, as JSON."""

    def __init__(self, solver: Solver, settings: Settings) -> None:
        self._lane = solver[LaneName.REQUESTS]
        self._deadline_s = settings.solve_deadline_s
        self._most_starts = settings.plan_starts
        self._ready: OrderedDict[Key, Solved] = OrderedDict()
        self._failed: OrderedDict[Key, ServiceError] = OrderedDict()
        self._under_way: dict[Key, asyncio.Task[None]] = {}

    async def of(self, plan_id: str, plan: str, resolves: int, wait_s: float) -> str | None:
        """Return the explanation of a plan (JSON) if it is ready within `wait_s` wall seconds, else None.

        Raises BusyError when the queue is full or the solver broke, InvalidError for a plan that cannot be explained:
        then the next request tries again. One for which time was too short is returned once, too.
        """
        key = (plan_id, resolves)
        if key not in self._ready and key not in self._failed:
            task = self._under_way.get(key) or self._begin(key, plan)
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await asyncio.shield(task)  # a client may give up waiting; it is made anyway
        if key in self._failed:
            raise self._failed.pop(key)
        solved = self._ready.get(key)
        if solved is None:
            return None
        if not solved.complete:
            del self._ready[key]
        return solved.report

    async def preview(
        self, plan: str, *, scenario: str | None, request: dict[str, Any], deadline_s: float | None = None
    ) -> str:
        """Return a comparison (JSON) of a plan (JSON) with a changed scenario (JSON), or with a replan by `request`.

        Raises BusyError when the queue is full or the solver broke, InvalidError when what is different has no plan.
        """
        job = Job(
            task="preview",
            previous=plan,
            scenario=scenario,
            request=request,
            deadline_s=deadline_s or min(PREVIEW_S, self._deadline_s),
            most_starts=self._most_starts,
        )
        try:
            return (await self._lane.solve(job)).report
        except SolveError as error:
            raise _as_service_error("scenario" if scenario else "changes", error) from error

    async def assess(self, plan: str, trial: dict[str, Any], deadline_s: float | None = None) -> str:
        """Return the robustness (JSON) of a plan (JSON) under a trial; what there is no time for is left out of it.

        Raises BusyError when the queue is full or the solver broke.
        """
        deadline_s = deadline_s or min(ASSESS_S, self._deadline_s)
        job = Job(task="assess", previous=plan, request=trial, deadline_s=deadline_s)
        try:
            return (await self._lane.solve(job)).report
        except SolveError as error:
            raise _as_service_error("plan_id", error) from error

    async def close(self) -> None:
        """Cancel the solves that are running."""
        for task in self._under_way.values():
            task.cancel()
        await asyncio.gather(*self._under_way.values(), return_exceptions=True)

    def _begin(self, key: Key, plan: str) -> asyncio.Task[None]:
        job = Job(task="explain", previous=plan, request={"most_resolves": key[1]}, deadline_s=self._deadline_s)
        task = asyncio.create_task(self._solve(key, job, self._lane.reserve()), name=f"explain {key[0]}")
        self._under_way[key] = task
        task.add_done_callback(lambda _: self._under_way.pop(key, None))
        return task

    async def _solve(self, key: Key, job: Job, token: int) -> None:
        try:
            _keep(self._ready, key, await self._lane.solve(job, token))
        except SolveError as error:
            _keep(self._failed, key, _as_service_error("plan_id", error))


def _keep(table: OrderedDict[Key, Any], key: Key, value: Any) -> None:
    table[key] = value
    while len(table) > KEEP_IN_MEMORY:
        table.popitem(last=False)


def _as_service_error(field: str, error: SolveError) -> ServiceError:
    if error.status is PlanStatus.INFEASIBLE:
        return InvalidError(f"{field}: {error}")
    return BusyError(f"solver: {error}")
