"""Solves in this process, at once; their results are delivered after as long as a worker would have taken."""

from __future__ import annotations

import asyncio
import re
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

from skyfolio.api.common.errors import BusyError
from skyfolio.api.plans.job_board import Progress
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.solver import LaneName, SolveError, Solver
from skyfolio.api.plans.solving import attempt
from skyfolio.planner import Cause, Iteration, Plan, PlanStatus

KEEP_SOLVED = 4096
_ID = re.compile(r'\{"id":"([^"]*)"')
MOST_JOBS = 256


class Workers:
    """What the modelled workers of all lanes have in common: how long they take, and whether they die.

    seconds: returns the virtual seconds that a job takes. `dead`: jobs that are given out fail, as with workers that
    end again and again.
    """

    def __init__(self, seconds: Callable[[Job], float]) -> None:
        self.seconds = seconds
        self.dead = False

    def solver(self) -> Solver:
        """Return the lanes of one service."""
        return Solver({name: ModelledLane(self) for name in LaneName})


class ModelledLane:
    """A `SolveLane` with one worker, which takes one job after the other in the order of their coming."""

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._worker = asyncio.Lock()
        self._free = list(range(MOST_JOBS))
        self._stopped: dict[int, asyncio.Event] = {}
        self._running: set[int] = set()

    @property
    def answers(self) -> bool:
        """Return whether it shows that it can solve."""
        return not self._workers.dead

    @property
    def warm(self) -> bool:
        """Return whether a job can begin at once."""
        return not self._workers.dead

    @property
    def busy(self) -> int:
        """Return how many jobs wait or run."""
        return MOST_JOBS - len(self._free)

    def reserve(self) -> int:
        """Return a token for one job. Raises BusyError when the queue is full."""
        if not self._free:
            raise BusyError(f"queue: {MOST_JOBS} solves are already waiting or running")
        token = self._free.pop()
        self._stopped[token] = asyncio.Event()
        return token

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best plan it has."""
        if token in self._stopped:
            self._stopped[token].set()

    def running(self, token: int) -> bool:
        """Return whether the job has begun."""
        return token in self._running

    def progress(self, token: int) -> Progress | None:
        """Return None: a modelled job shows nothing before its end."""
        del token
        return None

    async def best(self, token: int, plan_id: str) -> str | None:
        """Return None: a modelled job shows nothing before its end."""
        del token, plan_id
        return None

    async def solve(self, job: Job, token: int | None = None) -> Solved:
        """Run the job. Raises SolveError."""
        token = self.reserve() if token is None else token
        try:
            async with self._worker:
                self._running.add(token)
                try:
                    async with asyncio.timeout(min(self._workers.seconds(job), job.deadline_s)):
                        await self._stopped[token].wait()
                except TimeoutError:
                    pass
                finally:
                    self._running.discard(token)
            if self._workers.dead:
                raise SolveError(PlanStatus.FAILED, "the solver process died; the plan was not finished")
            solved = solved_at_once(job)
        finally:
            self._free.append(token)
            del self._stopped[token]
        if solved.error is not None:
            raise SolveError(solved.status, solved.error)
        return solved

    async def tend(self) -> None:
        """Do nothing."""

    def begin(self) -> None:
        """Do nothing."""

    async def warm_up(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class _Blank:
    """A board that is never read."""

    def stopped(self, token: int) -> bool:
        """Return false: how long a job takes is modelled."""
        del token
        return False

    def note(self, token: int, iteration: Iteration) -> None:
        """Forget it."""

    def show(self, token: int, plan: str) -> None:
        """Forget it."""


def solved_at_once(job: Job) -> Solved:
    """Return what a worker returns. What was solved before is kept, under whatever ids: many drills fly one plan."""
    if job.task != "plan":
        return attempt(job, _Blank(), 0, _no_time)
    previous_id, previous = None, job.previous
    if previous is not None:
        begin = _ID.match(previous)
        assert begin is not None, "a plan begins with its id"  # noqa: S101
        previous_id, previous = begin[1], f'{{"id":"plan"{previous[begin.end() :]}'
    solved = _solved(repr((job.scenario, previous, sorted(job.request.items()), job.starts, job.most_starts)), job)
    if solved.error is not None:
        return solved
    plan = Plan.model_validate_json(solved.plan)
    identity = {**job.identity, "cause": Cause.model_validate(job.identity.get("cause", {}))}
    plan = plan.model_copy(update={"parent": previous_id, **identity})
    return replace(solved, plan=plan.model_dump_json())


_kept: OrderedDict[str, Solved] = OrderedDict()


def _solved(key: str, job: Job) -> Solved:
    if key in _kept:
        _kept.move_to_end(key)
        return _kept[key]
    solved = _kept[key] = attempt(job, _Blank(), 0, _no_time)
    while len(_kept) > KEEP_SOLVED:
        _kept.popitem(last=False)
    return solved


def _no_time() -> float:
    return 0.0
