"""The jobs of a study on a Dask cluster that is already there, for more layouts and draws than one machine computes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Self

from anyio.from_thread import BlockingPortal, start_blocking_portal

from skyfolio.api.common.dask_cluster import SchedulerError, joined_cluster
from skyfolio.api.lab.reproduce.batch import Advance, J, R, Remembering, measured

PURPOSE = "computing the study on a cluster"


class ClusterBatch(Remembering):
    """The workers of a scheduler (`tcp://HOST:PORT`), which have the same skyfolio installed. A context manager.

    Results are fetched as they come and released at once: a worker that dies takes only what it was computing. Raises
    SchedulerError when the scheduler does not answer.
    """

    def __init__(self, advance: Advance, scheduler: str) -> None:
        super().__init__(advance)
        self._scheduler = scheduler

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._portal: BlockingPortal = stack.enter_context(start_blocking_portal())
            joined = joined_cluster(self._scheduler, PURPOSE)
            self._client: Any = stack.enter_context(self._portal.wrap_async_context_manager(joined))
            self._close = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._close.close()

    def _computed(self, work: Callable[[J], R], jobs: list[J]) -> Iterator[tuple[J, tuple[R, float]]]:
        ended: SimpleQueue[tuple[J, tuple[R, float]] | BaseException] = SimpleQueue()
        everything = self._portal.start_task_soon(self._all, work, jobs, ended.put)
        try:
            for _ in jobs:
                one = ended.get()
                if isinstance(one, BaseException):
                    raise one
                yield one
        finally:
            everything.cancel()

    async def _all(self, work: Callable[[J], R], jobs: list[J], put: Callable[[Any], None]) -> None:
        """Compute every job and put each with its result, or what ended it all."""
        futures = self._client.map(partial(measured, work), jobs, key="study", pure=False)
        try:
            async with asyncio.TaskGroup() as group:
                for job, future in zip(jobs, futures, strict=True):
                    group.create_task(self._one(job, future, put))
        except ExceptionGroup as failures:
            put(failures.exceptions[0])

    async def _one(self, job: J, future: Any, put: Callable[[Any], None]) -> None:
        """Fetch one result, and let the cluster forget it."""
        from distributed.client import FutureCancelledError  # noqa: PLC0415 - an extra

        try:
            put((job, await future))
        except FutureCancelledError as error:
            raise SchedulerError(f"scheduler: {self._scheduler} went away") from error
        future.release()
