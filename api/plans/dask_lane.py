"""A lane whose jobs run in a Dask cluster while there is one, and otherwise in workers of its own.

Only what clients ask for goes there. Replans of operations in the air stay with the worker that does nothing else: no
network, and no other client's solve, is between a loss and its replan.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import structlog

from skyfolio.api.common.dask_cluster import SchedulerError
from skyfolio.api.plans.dask_link import DaskLink
from skyfolio.api.plans.job_board import Progress
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.solver import (
    AHEAD_LIMIT,
    AHEAD_NICENESS,
    OVERRUN_S,
    Lane,
    LaneName,
    SolveError,
    Solver,
    flight_lane,
)
from skyfolio.planner import PlanStatus

log = structlog.get_logger()
PRIORITIES = {LaneName.REQUESTS: 10, LaneName.AHEAD: 0}
"""Of jobs that wait in the cluster, those of the higher number first."""


@dataclass
class _Away:
    """A job in the cluster. worker: its address, once it has begun."""

    name: str
    worker: str | None = None
    reached: Progress | None = None
    stopping: bool = False


class DaskLane(Lane):
    """A lane with the workers of a cluster; its own, which start when they are needed, step in."""

    def __init__(self, link: DaskLink, priority: int, workers: int, queue_limit: int, niceness: int = 0) -> None:
        super().__init__(workers, queue_limit, niceness)
        self._link, self._priority = link, priority
        self._away: dict[int, _Away] = {}
        self._errands: set[asyncio.Task[None]] = set()

    @property
    def answers(self) -> bool:
        """Return whether the cluster can be reached, or a worker of our own shows that it is alive."""
        return self._link.up or super().answers

    @property
    def warm(self) -> bool:
        """Return whether a job finds a worker: one of the cluster's loads kernels with its first job."""
        return self._link.up or super().warm

    async def warm_up(self) -> None:
        """Start workers of our own unless there is a cluster."""
        if not self._link.up:
            await super().warm_up()

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best plan it has."""
        super().stop(token)
        away = self._away.get(token)
        if away is not None:
            away.stopping = True
            self._send_stop(away)

    def running(self, token: int) -> bool:
        """Return whether a worker has begun the job."""
        away = self._away.get(token)
        return away.worker is not None if away else super().running(token)

    def progress(self, token: int) -> Progress | None:
        """Return what the job has reached, None before its first iteration."""
        away = self._away.get(token)
        return away.reached if away else super().progress(token)

    async def best(self, token: int, plan_id: str) -> str | None:
        """Return the best feasible plan of the job so far, as JSON; None while there is none or for another plan."""
        away = self._away.get(token)
        if away is None:
            return await super().best(token, plan_id)
        plan = await self._link.best(away.name, away.worker) if away.worker else None
        return plan if plan is not None and plan.startswith(f'{{"id":"{plan_id}",') else None

    async def solve(self, job: Job, token: int | None = None) -> Solved:
        """Run the job in the cluster, or in a worker of our own when that fails. Raises SolveError."""
        token = self.reserve() if token is None else token
        if self._link.up:
            try:
                solved = await self._solve_away(job, token)
            except SchedulerError as error:
                log.warning("a solve is done again by local workers", because=str(error))
            except BaseException:
                self.release(token)
                raise
            else:
                self.release(token)
                if solved.error is not None:
                    raise SolveError(solved.status, solved.error)
                return solved
        return await super().solve(job, token)

    async def _solve_away(self, job: Job, token: int) -> Solved:
        away = self._away[token] = _Away(uuid4().hex)
        solving = asyncio.create_task(
            self._link.solve(job, away.name, self._priority, lambda told: self._note(away, told)), name="solve away"
        )
        try:
            late_s = job.deadline_s + OVERRUN_S
            while not (await asyncio.wait([solving], timeout=late_s))[0]:
                if away.worker is not None:  # it has begun, and had all that time, or all but a moment
                    raise SolveError(PlanStatus.FAILED, "the solver hung beyond its deadline and was left behind")
            return solving.result()
        except (SchedulerError, SolveError):
            raise
        except Exception as error:
            raise SolveError(PlanStatus.FAILED, f"the solver died: {type(error).__name__}") from error
        finally:
            solving.cancel()
            del self._away[token]

    def _note(self, away: _Away, told: dict[str, Any]) -> None:
        away.worker = told["worker"]
        if "reached" in told:
            iterations, utility_bps, rate_bps = told["reached"]
            away.reached = Progress(iterations=iterations, utility_bps=utility_bps, mean_sum_rate_bps=rate_bps)
        if away.stopping and "began" in told:
            self._send_stop(away)

    def _send_stop(self, away: _Away) -> None:
        if away.worker is not None:
            errand = asyncio.create_task(self._link.stop(away.name, away.worker), name="stop a solve")
            self._errands.add(errand)
            errand.add_done_callback(self._errands.discard)


def solver_with(link: DaskLink, workers: int, queue_limit: int, flight: Lane | None = None) -> Solver:
    """Return a solver whose lanes of requests and contingencies use the cluster at the end of the link.

    The lane of flights has a worker of its own: `flight`, if it was started before.
    """
    return Solver(
        {
            LaneName.FLIGHT: flight or flight_lane(),
            LaneName.REQUESTS: DaskLane(link, PRIORITIES[LaneName.REQUESTS], workers, queue_limit),
            LaneName.AHEAD: DaskLane(link, PRIORITIES[LaneName.AHEAD], 1, AHEAD_LIMIT, AHEAD_NICENESS),
        },
        link,
    )
