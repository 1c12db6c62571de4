"""Connections to Dask: a cluster of worker processes that is started here, or a scheduler that runs elsewhere.

Dask executes what it is sent. So the cluster that is started here listens on loopback alone, and speaks TLS with
certificates that are made for it and never leave this process and its workers: another user of the machine cannot hand
work to it. A scheduler that runs elsewhere must be protected there (`docs/scaling.md`). Nothing of Dask is
imported before it is needed: it is an extra.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any

from skyfolio.api.common import extras
from skyfolio.api.common.errors import ServiceError

CONNECT_S = 10.0
"""A scheduler has so long to answer at first."""
WORKER_S = 60.0
"""Its first worker may come so much later."""
REAP_S = 30.0
"""A worker that was killed is gone at once; on a machine that is busy with other things it may take so long."""
LOOK_S = 0.05
STREAM_S = 1.0
CLOSE_S = 5.0
"""A client that is closing is left behind after so long: its scheduler may be gone."""
OWN: dict[str, Any] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.scheduler.worker-saturation": 1.0,  # what waits does so at the scheduler, and dies with no worker
    "distributed.nanny.pre-spawn-environ.DASK_LOGGING__DISTRIBUTED": "critical",  # workers are quiet from the start
}
LOGGERS = (
    "distributed",
    "distributed.client",
    "distributed.comm.tcp",
    "distributed.core",
    "distributed.nanny",
    "distributed.scheduler",
    "tornado.application",
)
LOOPBACK = "127.0.0.1"
SCHEMES = ("tcp://", "tls://")


class SchedulerError(ServiceError):
    """The Dask scheduler cannot be reached, or went away."""


@asynccontextmanager
async def own_cluster(workers: int, purpose: str) -> AsyncIterator[Any]:
    """Start `workers` processes of one thread each, and give their client; end them all within a second at the end.

    purpose: what needs it, for the message of MissingExtraError.
    """
    extras.require_all("sweep", purpose)
    import dask  # noqa: PLC0415 - an extra
    from distributed import Client, LocalCluster, Nanny  # noqa: PLC0415

    nannies: list[Any] = []

    class Known(Nanny):  # type: ignore[misc]  # Dask has no types
        """One that can be ended before the cluster has started."""

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            nannies.append(self)

    with dask.config.set(OWN), _quiet(), _without_ctrl_c():
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            protocol="tls",
            security=True,
            dashboard_address=f"{LOOPBACK}:0",
            worker_dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
            asynchronous=True,
            worker_class=Known,
        )
        try:
            await cluster
            async with Client(cluster, asynchronous=True, set_as_default=False) as client:
                yield client
        finally:
            await _ended(cluster, nannies)


async def _ended(cluster: Any, nannies: list[Any]) -> None:
    """Close a cluster, whether or not it has started."""
    unfinished = asyncio.all_tasks()
    streams = _streams(cluster)
    killing = asyncio.create_task(_killed(nannies), name="end workers")
    await asyncio.gather(*(nanny.close(timeout=REAP_S) for nanny in nannies))
    await cluster.close()
    killing.cancel()
    stopped = [asyncio.ensure_future(stream.stopped.wait()) for stream in streams]
    if stopped:  # what they have to say of workers that are gone is said before the log is as it was
        await asyncio.wait(stopped, timeout=STREAM_S)
    for waiting in stopped:
        waiting.cancel()
    for task in unfinished:
        if task.done() and not task.cancelled():
            task.exception()  # that of a start which was broken off here; asyncio would report it otherwise


def _streams(cluster: Any) -> list[Any]:
    """Return what sends the scheduler's messages to workers and clients."""
    scheduler = getattr(cluster, "scheduler", None)
    if scheduler is None:  # it has not started
        return []
    return [*scheduler.stream_comms.values(), *scheduler.client_comms.values()]


async def _killed(nannies: list[Any]) -> None:
    """Kill all workers, which hold nothing, and those that are just starting as soon as they have a process.

    Closing the cluster alone would wait for what they compute.
    """
    for nanny in nannies:
        nanny.close_gracefully()  # it is not to be started again
    while True:
        for nanny in nannies:
            if nanny.pid:
                with suppress(ProcessLookupError):  # it has just died by itself
                    os.kill(nanny.pid, signal.SIGKILL)
        await asyncio.sleep(LOOK_S)


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Have the processes that are started meanwhile never see Ctrl-C, from their first moment on.

    A terminal sends it to the whole group, and the process that started them ends them. They inherit which signals
    their parent's thread holds back; another thread receives it here.
    """
    resource_tracker.ensure_running()  # it lets Ctrl-C through again when it is started later
    over = threading.Event()
    threading.Thread(target=over.wait, name="receives Ctrl-C", daemon=True).start()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        over.set()


@asynccontextmanager
async def joined_cluster(address: str, purpose: str) -> AsyncIterator[Any]:
    """Give a client of the scheduler at this address (`tcp://HOST:PORT`, `tls://HOST:PORT`).

    Raises SchedulerError when it does not answer or the address is none.
    """
    extras.require_all("sweep", purpose)
    require_address(address)
    from distributed import Client  # noqa: PLC0415

    with _quiet():
        client = Client(address, asynchronous=True, set_as_default=False, timeout=CONNECT_S)
        try:
            await _connected(client, address)
            yield client
        finally:
            await _closed(client)


async def _closed(client: Any) -> None:
    """Close a client. A task that is cancelled meanwhile ends at once.

    Dask swallows a cancellation that meets its closing, which takes some seconds when the scheduler is gone.
    """

    async def close() -> None:
        await client.close()

    closing = asyncio.create_task(close(), name="close the client of a cluster")
    try:
        await asyncio.wait([closing], timeout=CLOSE_S)
    finally:
        if not closing.done():
            closing.cancel()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own log to what is critical: what goes wrong is raised here, and said in our words."""
    loggers = [logging.getLogger(name) for name in LOGGERS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


async def _connected(client: Any, address: str) -> None:
    """Wait for the scheduler, and for its first worker. Raises SchedulerError when one of them does not come."""
    try:
        await client
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler: nobody answers at {address} ({error})") from error
    try:
        await client.wait_for_workers(1, timeout=WORKER_S)
    except TimeoutError as error:
        raise SchedulerError(f"scheduler: {address} has had no worker for {WORKER_S:g} s") from error


def require_address(address: str, field: str = "scheduler") -> None:
    """Check that an address may be a scheduler's. Raises SchedulerError naming the field."""
    if not address.startswith(SCHEMES):
        raise SchedulerError(f"{field}: {address!r} must begin with {' or '.join(SCHEMES)}")
