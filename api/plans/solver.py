"""Solves in worker processes: the event loop that watches heartbeats never waits for an optimiser.

Three lanes: `flight` for replans of operations in the air and nothing else, `requests` for those of clients, `ahead`
for contingencies, made in flight or for a client. Neither a client nor a plan that may never be needed can delay a
fleet. Scenarios and plans pass between processes as JSON, which is also what is stored and sent: nothing is encoded
twice.
"""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from skyfolio.api.common.errors import BusyError
from skyfolio.api.plans.job_board import JobBoard, Progress
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.lane_port import ClusterLink, SolveLane
from skyfolio.api.plans.liveness import WorkerHeartbeats
from skyfolio.api.plans.worker import begin_worker, ready, run
from skyfolio.planner import PlanStatus

OVERRUN_S = 10.0
"""A worker that exceeds its deadline by so much hangs, and is killed."""
START_S = 60.0
"""A new worker has so long to send its first heartbeat."""
CLOSE_S = 0.5
"""Workers have so long to end by themselves."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
"""Pauses between two attempts to start workers that end before they are warm."""
MOST_PATIENCE = 16.0
AHEAD_LIMIT, AHEAD_NICENESS = 256, 5


class LaneName(StrEnum):
    """Which workers run a job."""

    REQUESTS = "requests"
    FLIGHT = "flight"
    AHEAD = "ahead"


class SolveError(Exception):
    """The solve has no result. `status`: infeasible when the problem has no solution, failed when the solver broke."""

    def __init__(self, status: PlanStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class Lane:
    """A pool of planner processes with a bounded queue, and a board on which each job has a row."""

    def __init__(self, workers: int, queue_limit: int, niceness: int = 0) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._folder = tempfile.TemporaryDirectory(prefix="skyfolio-plans-")
        self._board = JobBoard(self._context, queue_limit, Path(self._folder.name))
        self._free = list(range(queue_limit))
        self._limit = queue_limit
        self._niceness = niceness
        self.workers = workers
        self._patience = 1.0
        self._starting: asyncio.Task[None] | None = None
        self._closed = False
        self._pool = self._make_pool()

    def _make_pool(self) -> ProcessPoolExecutor:
        self._heartbeats = WorkerHeartbeats(self._context, self.workers)
        self._asked_s = math.inf
        shared = (self._board, self._niceness, *self._heartbeats.shared)
        return ProcessPoolExecutor(self.workers, mp_context=self._context, initializer=begin_worker, initargs=shared)

    @property
    def answers(self) -> bool:
        """Return whether a worker shows that it is alive.

        A lane that was never needed has nothing to show. A worker that is starting is given time, unless the
        one before it ended while it was cold.
        """
        if self._heartbeats.begun:
            return self._heartbeats.answer()
        return self._patience == 1.0 and time.monotonic() - self._asked_s < START_S

    @property
    def warm(self) -> bool:
        """Return whether all workers exist and have loaded all kernels."""
        return self._heartbeats.warm == self.workers

    async def tend(self) -> None:
        """Replace workers that died or are stuck; their jobs are tried once more."""
        self._heartbeats.kill_stuck(self._patience)
        if self._heartbeats.begun and self._heartbeats.gone():
            self._renew(self._pool)
        if self._asked_s < math.inf and not self._heartbeats.warm and (self._starting is None or self._starting.done()):
            self._starting = asyncio.create_task(self.warm_up(), name="start-workers")
        elif self._starting is not None and self._starting.done():
            self._starting.result()  # raises what went wrong, for the supervisor

    def _renew(self, broken: ProcessPoolExecutor) -> None:
        """Replace the broken pool, once. After workers that ended while cold, the next ones are given more time."""
        if self._pool is broken and not self._closed:
            self._patience = 1.0 if self._heartbeats.warm else min(MOST_PATIENCE, self._patience * 2.0)
            self._pool = self._make_pool()
            self._asked_s = time.monotonic()
            broken.shutdown(wait=False)

    @property
    def busy(self) -> int:
        """Return how many jobs wait or run."""
        return self._limit - len(self._free)

    def reserve(self) -> int:
        """Return a token for one job. Raises BusyError when the queue is full."""
        if not self._free:
            raise BusyError(f"queue: {self._limit} solves are already waiting or running")
        token = self._free.pop()
        self._board.clear(token)
        return token

    def release(self, token: int) -> None:
        """Give a token back whose job ran elsewhere."""
        self._free.append(token)

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best plan it has."""
        self._board.stop(token)

    def running(self, token: int) -> bool:
        """Return whether a worker has begun the job."""
        return self._board.worker(token).began_s > 0

    def progress(self, token: int) -> Progress | None:
        """Return what the job has reached, None before its first iteration."""
        return self._board.progress(token)

    async def best(self, token: int, plan_id: str) -> str | None:
        """Return the best feasible plan of the job so far, as JSON; None while there is none or for another plan."""
        if not self.running(token):
            return None
        plan = await asyncio.to_thread(self._board.best, token)
        return plan if plan is not None and plan.startswith(f'{{"id":"{plan_id}",') else None

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
            self._asked_s = min(self._asked_s, time.monotonic())
            future = asyncio.wrap_future(pool.submit(run, job, token))
            future.add_done_callback(_seen)
            while not (await asyncio.wait([future], timeout=OVERRUN_S))[0]:
                pid, began_s = self._board.worker(token)
                late = time.monotonic() > began_s + job.deadline_s + OVERRUN_S
                if pid and late and not self._heartbeats.is_cold(pid):
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                    raise TimeoutError
            return future.result()
        except BrokenProcessPool:
            self._renew(pool)
            raise

    def begin(self) -> None:
        """Start a worker without waiting for it."""
        self._asked_s = min(self._asked_s, time.monotonic())
        self._pool.submit(ready)

    async def warm_up(self) -> None:
        """Start the workers, and wait until they have loaded or compiled all kernels, restarting them as needed."""
        pause_s = FIRST_PAUSE_S
        while not self._closed:
            pool = self._pool
            try:
                self._asked_s = min(self._asked_s, time.monotonic())
                await asyncio.gather(*(asyncio.wrap_future(pool.submit(ready)) for _ in range(self.workers)))
            except BrokenProcessPool:
                self._renew(pool)
            else:
                self._patience = 1.0
                return
            await asyncio.sleep(pause_s)
            pause_s = min(LONGEST_PAUSE_S, pause_s * 2.0)

    def close(self) -> None:
        """End the workers: drop the jobs that wait, ask those that run to stop, and kill those that do not."""
        self._closed = True
        for token in range(self._limit):
            self._board.stop(token)
        workers = list((self._pool._processes or {}).values())  # Python 3.14 has `kill_workers`
        self._pool.shutdown(wait=False, cancel_futures=True)
        until_s = time.monotonic() + CLOSE_S
        for worker in workers:
            worker.join(max(0.0, until_s - time.monotonic()))
            if worker.is_alive():
                worker.kill()
                worker.join()
        self._folder.cleanup()


def _seen(done: asyncio.Future[Solved]) -> None:
    """Take notice of an error that no request waits for: it was cancelled before its worker died."""
    if not done.cancelled():
        done.exception()


def flight_lane() -> Lane:
    """Return the lane of replans in flight: one worker."""
    return Lane(1, 256)


class Solver:
    """All lanes. `link`: the connection to a cluster in which some of them solve, if there is one."""

    def __init__(self, lanes: Mapping[LaneName, SolveLane], link: ClusterLink | None = None) -> None:
        self.lanes, self.link = lanes, link

    def __getitem__(self, name: LaneName) -> SolveLane:
        return self.lanes[name]

    @property
    def warm(self) -> bool:
        """Return whether a replan in flight finds a warm worker.

        The workers of clients follow within a second: the first worker has compiled the kernels for all.
        """
        return self[LaneName.FLIGHT].warm

    def begin(self) -> None:
        """Start the worker of flights without waiting for it."""
        self[LaneName.FLIGHT].begin()

    async def warm_up(self) -> None:
        """Warm all workers, those of flights first: on a new machine the first compiles for all."""
        for lane in self.lanes.values():
            await lane.warm_up()

    def close(self) -> None:
        """End all workers at once."""
        with ThreadPoolExecutor(len(self.lanes)) as closing:
            list(closing.map(lambda lane: lane.close(), self.lanes.values()))


def solver_of_processes(workers: int, queue_limit: int, flight: Lane | None = None) -> Solver:
    """Return all lanes with processes of their own, so many for clients.

    flight: the lane of flights, if it was started before the rest of the service was imported.
    """
    return Solver(
        {
            LaneName.FLIGHT: flight or flight_lane(),
            LaneName.REQUESTS: Lane(workers, queue_limit),
            LaneName.AHEAD: Lane(1, AHEAD_LIMIT, AHEAD_NICENESS),
        }
    )
