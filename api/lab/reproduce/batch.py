"""Many jobs, each computed once, on all cores; `Runs` is what the study asks of whatever computes them."""

from __future__ import annotations

import multiprocessing
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

J = TypeVar("J", bound=Hashable)
R = TypeVar("R")
Advance = Callable[[int, int], None]
"""Called with (done, known so far) whenever a job ends."""


def silent(done: int, of: int) -> None:
    """Ignore the progress."""


def measured(work: Callable[[J], R], job: J) -> tuple[R, float]:
    """`work(job)`, and the processor time it took, seconds; runs in a worker process."""
    began = time.process_time()
    return work(job), time.process_time() - began


class Runs(Protocol):
    """Whatever maps work over jobs: the pool below, or a cluster.

    All work of a study goes through `run`: module-level functions of one hashable, picklable job each, whose results
    do not depend on the order or on each other.
    """

    @property
    def core_seconds(self) -> float:
        """Return the processor time spent so far."""
        ...

    def run(self, work: Callable[[J], R], jobs: Iterable[J]) -> dict[J, R]:
        """Return `work(job)` of every job."""
        ...


class Remembering(ABC):
    """Computes each job once, and counts what is done. `core_seconds`: processor time, whatever else runs meanwhile."""

    def __init__(self, advance: Advance) -> None:
        self.core_seconds = 0.0
        self._advance = advance
        self._known: dict[tuple[str, Hashable], Any] = {}
        self._done = self._asked = 0

    def run(self, work: Callable[[J], R], jobs: Iterable[J]) -> dict[J, R]:
        """Return `work(job)` of every job; earlier results are not computed again. Raises what `work` raises."""
        jobs = list(dict.fromkeys(jobs))
        new = [job for job in jobs if (work.__qualname__, job) not in self._known]
        self._asked += len(new)
        self._advance(self._done, self._asked)
        for job, (result, spent) in self._computed(work, new):
            self._known[work.__qualname__, job] = result
            self.core_seconds += spent
            self._done += 1
            self._advance(self._done, self._asked)
        return {job: self._known[work.__qualname__, job] for job in jobs}

    @abstractmethod
    def _computed(self, work: Callable[[J], R], jobs: list[J]) -> Iterator[tuple[J, tuple[R, float]]]:
        """Yield each job with what `measured` gives, in any order."""


class Batch(Remembering):
    """A pool of worker processes of this machine. Use as a context manager."""

    def __init__(self, advance: Advance, workers: int | None = None) -> None:
        super().__init__(advance)
        self._workers = workers or os.cpu_count() or 1

    def __enter__(self) -> Self:
        self._pool = ProcessPoolExecutor(self._workers, mp_context=multiprocessing.get_context("spawn"))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _computed(self, work: Callable[[J], R], jobs: list[J]) -> Iterator[tuple[J, tuple[R, float]]]:
        futures = {self._pool.submit(measured, work, job): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()
