"""Solves run in worker processes: the event loop that watches heartbeats never waits for an optimiser."""

from __future__ import annotations

import asyncio
import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any

from api.problems import BusyError
from planner import EXAMPLES, AnyOf, Deadline, Plan, Scenario, StopToken, converged, plan, replan

_stop_flags: Sequence[int] = ()


@dataclass(frozen=True, kw_only=True)
class Job:
    """One solve: a scenario to plan, or a previous plan to replan with `request` (arguments of `planner.replan`)."""

    scenario: Scenario | None = None
    previous: Plan | None = None
    request: dict[str, Any] = field(default_factory=dict)
    identity: dict[str, Any] = field(default_factory=dict)
    deadline_s: float | None = None


def _remember(flags: Sequence[int]) -> None:
    global _stop_flags  # noqa: PLW0603 - set once when a worker process starts
    _stop_flags = flags


def _run(job: Job, token: int) -> Plan:
    rules: list[Any] = [converged(), StopToken(lambda: bool(_stop_flags[token]))]
    if job.deadline_s is not None:
        rules.append(Deadline(job.deadline_s, clock=time.monotonic))
    options: dict[str, Any] = {"stop": AnyOf(*rules), "clock": time.perf_counter, **job.identity}
    if job.previous is not None:
        return replan(job.previous, **job.request, **options)
    assert job.scenario is not None  # noqa: S101 - one of the two is always given
    return plan(job.scenario, **options)


class Solver:
    """A pool of planner processes with a bounded queue and a stop flag for each job."""

    def __init__(self, workers: int, queue_limit: int) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._flags = self._context.Array("b", queue_limit, lock=False)
        self._free = list(range(queue_limit))
        self._workers = workers
        self._pool = self._make_pool()

    def _make_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self._workers, mp_context=self._context, initializer=_remember, initargs=(self._flags,)
        )

    async def warm_up(self) -> None:
        """Start the workers and let them import and solve once, so that the first real solve is a fast one."""
        await asyncio.gather(*(self.solve(Job(scenario=EXAMPLES["minimal"]())) for _ in range(self._workers)))

    def reserve(self) -> int:
        """A stop token for one job. Raises BusyError when `queue_limit` jobs are already under way."""
        if not self._free:
            raise BusyError(f"queue: {len(self._flags)} solves are already waiting or running")
        token = self._free.pop()
        self._flags[token] = 0
        return token

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best it has."""
        self._flags[token] = 1

    async def solve(self, job: Job, token: int | None = None, started: Callable[[], None] | None = None) -> Plan:
        """Run the job in a worker. Raises what the planner raises, or RuntimeError when the worker died."""
        token = self.reserve() if token is None else token
        try:
            future = self._pool.submit(_run, job, token)
            if started:
                started()
            return await asyncio.wrap_future(future)
        except BrokenProcessPool as error:
            self._pool = self._make_pool()
            raise RuntimeError("the solver process died; the plan was not finished") from error
        finally:
            self._free.append(token)

    def close(self) -> None:
        """End the workers; jobs that wait are dropped, those that run are asked to stop."""
        for token in range(len(self._flags)):
            self._flags[token] = 1
        self._pool.shutdown(wait=True, cancel_futures=True)
