"""Solves run in worker processes: the event loop that watches heartbeats never waits for an optimiser.

Two lanes: `requests` for what clients ask, `flight` for replans of operations in the air and, in idle time, for plans
ahead of a loss. A client cannot make a fleet wait. Scenarios and plans cross the border between processes as JSON,
which is also what is stored and answered: nothing is encoded twice.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from multiprocessing import connection
from typing import Any

from pydantic import BaseModel

from api.errors import BusyError
from planner import (
    EXAMPLES,
    AnyOf,
    Cause,
    Deadline,
    Iteration,
    Plan,
    PlanStatus,
    ReplanError,
    Scenario,
    StopToken,
    converged,
    plan,
    replan,
)
from planner.fast.optimise import default_starts
from planner.problem import problem_of

OVERRUN_S = 10.0
"""A worker that is so late beyond its deadline hangs, and is killed."""
_FIELDS = 5  # of a job's board: worker's process id, when it began, iterations, utility, mean sum rate

_stop_flags: Any = ()
_board: Any = ()


class LaneName(StrEnum):
    """Which workers run a job."""

    REQUESTS = "requests"
    FLIGHT = "flight"


class SolveError(Exception):
    """A solve without a result: `status` infeasible when the problem has none, failed when the solver broke."""

    def __init__(self, status: PlanStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class Progress(BaseModel):
    """How far a running solve is: the best feasible plan so far is worth this much. Rates in bit/s."""

    iterations: int
    utility_bps: float
    mean_sum_rate_bps: float


@dataclass(frozen=True, kw_only=True)
class Job:
    """One solve, as JSON: a scenario to plan, or a previous plan to replan with `request` (as `planner.replan`).

    `starts`: how many the optimiser climbs from; None lets it choose by size, a plan's then at most `most_starts`.
    """

    scenario: str | None = None
    previous: str | None = None
    request: dict[str, Any] = field(default_factory=dict)
    identity: dict[str, Any] = field(default_factory=dict)
    deadline_s: float = 60.0
    starts: int | None = None
    most_starts: int = 64


@dataclass(frozen=True, kw_only=True)
class Solved:
    """What a worker hands back: a plan as JSON with its status, or how it failed."""

    status: PlanStatus
    plan: str = ""
    summary: str = ""
    iterations: int = 0
    solve_ms: float = 0.0
    error: str | None = None


# --- in a worker ---


def _begin_worker(flags: Any, board: Any) -> None:
    global _stop_flags, _board
    _stop_flags, _board = flags, board
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches the group; the service ends workers
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker of a service that was killed would wait for jobs forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _run(job: Job, token: int) -> Solved:
    _board[token * _FIELDS : token * _FIELDS + 2] = [os.getpid(), time.monotonic()]
    try:
        made = _solve(job, token)
    except ReplanError as error:
        return Solved(status=PlanStatus.INFEASIBLE, error=str(error))
    except ValueError as error:
        return Solved(status=PlanStatus.INFEASIBLE, error=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not break the pool
        return Solved(status=PlanStatus.FAILED, error=f"{type(error).__name__}: {error}")
    finally:
        _board[token * _FIELDS] = 0
    return Solved(
        status=made.status,
        plan=made.model_dump_json(),
        summary=made.summary.model_dump_json(),
        iterations=len(made.history),
        solve_ms=made.solve_ms or 0.0,
    )


def _solve(job: Job, token: int) -> Plan:
    stop = AnyOf(
        converged(), StopToken(lambda: bool(_stop_flags[token])), Deadline(job.deadline_s, clock=time.monotonic)
    )
    identity = {**job.identity, "cause": Cause.model_validate(job.identity.get("cause", {}))}
    options = {
        "stop": stop,
        "clock": time.perf_counter,
        "observer": _observer(token),
        **identity,
    }
    if job.previous is not None:
        return replan(Plan.model_validate_json(job.previous), **job.request, n_starts=job.starts, **options)
    assert job.scenario is not None  # noqa: S101 - one of the two is always given
    scenario = Scenario.model_validate_json(job.scenario)
    return plan(scenario, n_starts=job.starts or min(job.most_starts, default_starts(problem_of(scenario))), **options)


def _observer(token: int) -> Callable[[Iteration], None]:
    def note(iteration: Iteration) -> None:
        at = token * _FIELDS
        _board[at + 2 : at + _FIELDS] = [iteration.iteration, iteration.utility_bps, iteration.mean_sum_rate_bps]

    return note


# --- in the service ---


class Lane:
    """A pool of planner processes with a bounded queue; a stop flag and a progress board for each job."""

    def __init__(self, workers: int, queue_limit: int) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._flags = self._context.Array("b", queue_limit, lock=False)
        self._board = self._context.Array("d", queue_limit * _FIELDS, lock=False)
        self._free = list(range(queue_limit))
        self._limit = queue_limit
        self.workers = workers
        self._pool = self._make_pool()

    def _make_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self.workers, mp_context=self._context, initializer=_begin_worker, initargs=(self._flags, self._board)
        )

    @property
    def busy(self) -> int:
        """Jobs waiting or running."""
        return self._limit - len(self._free)

    def reserve(self) -> int:
        """A token for one job. Raises BusyError when the queue is full."""
        if not self._free:
            raise BusyError(f"queue: {self._limit} solves are already waiting or running")
        token = self._free.pop()
        self._flags[token] = 0
        self._board[token * _FIELDS : (token + 1) * _FIELDS] = [0.0] * _FIELDS
        return token

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best it has."""
        self._flags[token] = 1

    def running(self, token: int) -> bool:
        """Whether a worker has begun with the job."""
        return float(self._board[token * _FIELDS + 1]) > 0

    def progress(self, token: int) -> Progress | None:
        """What the job has reached, None before its first iteration."""
        _, _, iterations, utility, rate = self._board[token * _FIELDS : (token + 1) * _FIELDS]
        if not iterations:
            return None
        return Progress(iterations=int(iterations), utility_bps=utility, mean_sum_rate_bps=rate)

    async def solve(self, job: Job, token: int | None = None) -> Solved:
        """Run the job in a worker. Raises SolveError; a job whose worker died is tried once more."""
        token = self.reserve() if token is None else token
        try:
            try:
                solved = await self._submit(job, token)
            except BrokenProcessPool:  # perhaps by a neighbour's fault
                solved = await self._submit(job, token)
        except BrokenProcessPool as error:
            raise SolveError(PlanStatus.FAILED, "the solver process died; the plan was not finished") from error
        except TimeoutError as error:
            raise SolveError(PlanStatus.FAILED, "the solver hung beyond its deadline and was killed") from error
        finally:
            self._free.append(token)
        if solved.error is not None:
            raise SolveError(solved.status, solved.error)
        return solved

    async def _submit(self, job: Job, token: int) -> Solved:
        pool = self._pool
        try:
            future = asyncio.wrap_future(pool.submit(_run, job, token))
            while not (await asyncio.wait([future], timeout=OVERRUN_S))[0]:
                pid, began = self._board[token * _FIELDS : token * _FIELDS + 2]
                if pid and time.monotonic() > began + job.deadline_s + OVERRUN_S:
                    with suppress(ProcessLookupError):
                        os.kill(int(pid), signal.SIGKILL)
                    raise TimeoutError
            return future.result()
        except BrokenProcessPool:
            if self._pool is pool:
                self._pool = self._make_pool()
            raise

    async def warm_up(self) -> None:
        """Start the workers and let them import and solve once, so that the first real solve is a fast one."""
        job = Job(scenario=EXAMPLES["minimal"]().model_dump_json())
        await asyncio.gather(*(self.solve(job) for _ in range(self.workers)))

    def close(self) -> None:
        """End the workers; jobs that wait are dropped, those that run are asked to stop."""
        for token in range(self._limit):
            self._flags[token] = 1
        self._pool.shutdown(wait=True, cancel_futures=True)


class Solver:
    """Both lanes."""

    def __init__(self, workers: int, queue_limit: int) -> None:
        self.warm: set[LaneName] = set()
        self.lanes = {LaneName.REQUESTS: Lane(workers, queue_limit), LaneName.FLIGHT: Lane(1, 256)}

    def __getitem__(self, name: LaneName) -> Lane:
        return self.lanes[name]

    async def warm_up(self) -> None:
        """Ready all workers."""
        for name in (LaneName.FLIGHT, LaneName.REQUESTS):  # one after the other: on a new machine the first compiles
            await self.lanes[name].warm_up()
            self.warm.add(name)

    def close(self) -> None:
        """End all workers."""
        for lane in self.lanes.values():
            lane.close()
