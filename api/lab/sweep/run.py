"""A sweep from its spec to its parts: what is there is kept, the rest is computed."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skyfolio.api.common import extras
from skyfolio.api.common.dask_cluster import joined_cluster, own_cluster
from skyfolio.api.lab.sweep.farm import Work, farmed
from skyfolio.api.lab.sweep.parts import Batch, Parts, batches_of, compute
from skyfolio.api.lab.sweep.settings import check
from skyfolio.api.lab.sweep.spec import Spec

PURPOSE = "a sweep"
SHOWN_ERRORS = 5
Advance = Callable[[int, int], None]
"""Called with (cases whose rows are stored, all cases)."""


@dataclass(kw_only=True)
class Outcome:
    """How far a sweep is. found: cases that were stored before it began. errors: of batches that broke, the first."""

    cases: int
    found: int
    stored: int
    seconds: float = 0.0
    broken: int = 0
    stopped: bool = False
    errors: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Return whether every case has its row."""
        return self.stored == self.cases


def run_sweep(
    spec: Spec, out: Path, *, scheduler: str | None = None, workers: int | None = None, advance: Advance | None = None
) -> Outcome:
    """Compute what is missing of a sweep into the folder `out`, until it is complete or Ctrl-C or SIGTERM arrives.

    scheduler: of a cluster that runs elsewhere; by default one of `workers` processes (one for each core) is started.
    Raises SpecError, SweepError, SchedulerError and MissingExtraError.
    """
    extras.require_all("sweep", PURPOSE)
    check(spec)

    async def run() -> Outcome:
        stop = asyncio.Event()
        with _until_interrupted(stop):
            return await sweep(spec, out, cluster(scheduler, workers), stop, advance)

    return asyncio.run(run())


async def sweep(
    spec: Spec, out: Path, engine: Any, stop: asyncio.Event, advance: Advance | None = None, work: Work = compute
) -> Outcome:
    """Do as `run_sweep` on a cluster, until `stop` is set. engine: an async context manager that gives its client."""
    began_s = time.monotonic()
    batches, parts = batches_of(spec), Parts(out)
    with parts.held():
        parts.describe(spec, batches)
        there = parts.there()
        missing = [batch for batch in batches if batch.address not in there]
        found = _cases(batches) - _cases(missing)
        outcome = Outcome(cases=spec.n_cases, found=found, stored=found)
        show = advance or (lambda stored, of: None)  # noqa: ARG005
        show(outcome.stored, outcome.cases)
        if missing:
            async with AsyncExitStack() as stack:
                client = await _unless(stop, stack.enter_async_context(engine))
                async for done in farmed(client, work, missing, stop):
                    if done.error is not None:
                        _note_broken(outcome, done.batch, done.error)
                        continue
                    parts.write(done.batch.address, done.part)
                    outcome.stored += len(done.batch.cases)
                    show(outcome.stored, outcome.cases)
    outcome.stopped = stop.is_set() and not outcome.complete
    outcome.seconds = time.monotonic() - began_s
    return outcome


async def _unless(stop: asyncio.Event, starting: Coroutine[Any, Any, Any]) -> Any:
    """Return what starts, or None when `stop` is set before: a start may wait for a scheduler or its first worker."""
    started = asyncio.create_task(starting, name="engine")
    stopping = asyncio.create_task(stop.wait(), name="stop")
    try:
        await asyncio.wait((started, stopping), return_when=asyncio.FIRST_COMPLETED)
        if not started.done():
            return None
        return started.result()
    finally:
        for task in (started, stopping):
            task.cancel()
        await asyncio.gather(started, stopping, return_exceptions=True)


@asynccontextmanager
async def cluster(scheduler: str | None, workers: int | None) -> AsyncIterator[Any]:
    """Give the client of the scheduler at this address, or of an own cluster of `workers` processes."""
    engine = (
        own_cluster(workers or os.cpu_count() or 1, PURPOSE)
        if scheduler is None
        else joined_cluster(scheduler, PURPOSE)
    )
    async with engine as client:
        yield client


def _cases(batches: list[Batch]) -> int:
    return sum(len(batch.cases) for batch in batches)


def _note_broken(outcome: Outcome, batch: Batch, error: str) -> None:
    outcome.broken += 1
    if len(outcome.errors) < SHOWN_ERRORS:
        outcome.errors.append(f"cases {batch.first} to {batch.first + len(batch.cases) - 1}: {error}")


@contextmanager
def _until_interrupted(stop: asyncio.Event) -> Iterator[None]:
    """Set `stop` on Ctrl-C and SIGTERM; what is finished is then stored, and workers are ended."""
    loop = asyncio.get_running_loop()
    numbers = (signal.SIGINT, signal.SIGTERM)
    for number in numbers:
        loop.add_signal_handler(number, stop.set)
    try:
        yield
    finally:
        for number in numbers:
            with suppress(ValueError):
                loop.remove_signal_handler(number)
