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
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from api.board import Board, Progress
from api.errors import BusyError
from api.solving import Job, Solved, begin_worker, run
from planner import EXAMPLES, PlanStatus

OVERRUN_S = 10.0
"""A worker that is so late beyond its deadline hangs, and is killed."""


class LaneName(StrEnum):
    """Which workers run a job."""

    REQUESTS = "requests"
    FLIGHT = "flight"


class SolveError(Exception):
    """A solve without a result: `status` infeasible when the problem has none, failed when the solver broke."""

    def __init__(self, status: PlanStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class Lane:
    """A pool of planner processes with a bounded queue, and a board on which each job has a row."""

    def __init__(self, workers: int, queue_limit: int) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._folder = tempfile.TemporaryDirectory(prefix="skyfolio-plans-")
        self._board = Board(self._context, queue_limit, Path(self._folder.name))
        self._free = list(range(queue_limit))
        self._limit = queue_limit
        self.workers = workers
        self._pool = self._make_pool()

    def _make_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self.workers, mp_context=self._context, initializer=begin_worker, initargs=(self._board,)
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
        self._board.clear(token)
        return token

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best it has."""
        self._board.stop(token)

    def running(self, token: int) -> bool:
        """Whether a worker has begun with the job."""
        return self._board.worker(token).began_s > 0

    def progress(self, token: int) -> Progress | None:
        """What the job has reached, None before its first iteration."""
        return self._board.progress(token)

    async def best(self, token: int, plan_id: str) -> str | None:
        """The best feasible plan of the job so far, as JSON; None while it has shown none, or is another plan's."""
        if not self.running(token):
            return None
        shown = await asyncio.to_thread(self._board.best, token)
        return shown if shown is not None and shown.startswith(f'{{"id":"{plan_id}",') else None

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
            future = asyncio.wrap_future(pool.submit(run, job, token))
            while not (await asyncio.wait([future], timeout=OVERRUN_S))[0]:
                pid, began_s = self._board.worker(token)
                if pid and time.monotonic() > began_s + job.deadline_s + OVERRUN_S:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
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
            self._board.stop(token)
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._folder.cleanup()


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
