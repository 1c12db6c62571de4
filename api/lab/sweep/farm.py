"""Batches on the workers of a Dask cluster, each result fetched and released at once.

Dask computes finished work again when the worker that held it dies. So nothing finished is left with a worker: as soon
as a batch is done its result is fetched, handed over and released. What can be lost is what a worker was computing when
it died.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from skyfolio.api.common.dask_cluster import SchedulerError
from skyfolio.api.common.planner_identity import OtherPlannerError
from skyfolio.api.lab.sweep.parts import Batch, SweepError

AHEAD = 1024
"""At most so many batches are with the cluster at a time, most of them waiting."""
LAST_S = 0.3
"""Results that are on their way when it is stopped have so long to arrive."""
Work = Callable[[Batch], bytes]


@dataclass(frozen=True, kw_only=True)
class Done:
    """A batch, and its result or why it has none."""

    batch: Batch
    part: bytes = b""
    error: str | None = None


async def farmed(client: Any, work: Work, batches: Sequence[Batch], stop: asyncio.Event) -> AsyncIterator[Done]:
    """Yield each batch as it is done, in no order, until all are or `stop` is set.

    A batch whose work raises, or kills several workers, has an error. Raises SchedulerError when the scheduler goes
    away, SweepError when a worker has another planner.
    """
    waiting = deque(batches)
    running: set[asyncio.Task[Done]] = set()
    ended: asyncio.Queue[asyncio.Task[Done] | asyncio.Task[Literal[True]]] = asyncio.Queue()
    stopping = asyncio.create_task(stop.wait(), name="stop")
    stopping.add_done_callback(ended.put_nowait)
    try:
        while (waiting or running) and not stop.is_set():
            next_ones = [waiting.popleft() for _ in range(min(len(waiting), AHEAD - len(running)))]
            for batch, future in zip(next_ones, _submitted(client, work, next_ones), strict=True):
                task = asyncio.create_task(_one(future, batch))
                running.add(task)
                task.add_done_callback(running.discard)
                task.add_done_callback(ended.put_nowait)
            done = (await ended.get()).result()
            if isinstance(done, Done):
                yield done
        if running:
            await asyncio.wait(running, timeout=LAST_S)
        while not ended.empty():
            done = ended.get_nowait().result()
            if isinstance(done, Done):
                yield done
    finally:
        for left in (*running, stopping):
            left.cancel()
        await asyncio.gather(*running, stopping, *_all_in(ended), return_exceptions=True)


def _all_in(queue: asyncio.Queue[Any]) -> list[Any]:
    return [queue.get_nowait() for _ in range(queue.qsize())]


def _submitted(client: Any, work: Work, batches: Sequence[Batch]) -> Sequence[Any]:
    """Hand batches to the cluster. Named alike and handed over together, they wait at the scheduler for a free worker.

    Dask would give each batch of a name of its own to a worker at once, and each worker's death would be blamed on all
    that wait there.
    """
    keys = [f"sweep-{batch.address}" for batch in batches]
    futures: Sequence[Any] = client.map(work, batches, key=keys, pure=False) if batches else []
    return futures


async def _one(future: Any, batch: Batch) -> Done:
    """Fetch the result of a batch, and let the cluster forget it."""
    from distributed.client import FutureCancelledError  # noqa: PLC0415 - an extra

    try:
        done = Done(batch=batch, part=await future)
    except FutureCancelledError as error:  # there is nobody who could be asked to forget it
        raise _went_away() from error
    except OtherPlannerError as error:
        raise SweepError(f"a worker of the cluster cannot take part: {error}") from error
    except Exception as error:
        if future.status != "error":  # nothing broke it: what it computed cannot be fetched
            raise _went_away() from error
        done = Done(batch=batch, error=f"{type(error).__name__}: {error}")
    future.release()
    return done


def _went_away() -> SchedulerError:
    return SchedulerError("scheduler: it went away; start the sweep again to compute the rest")
