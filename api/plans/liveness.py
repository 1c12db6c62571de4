"""Tells whether worker processes respond: each writes heartbeats into shared memory, from a thread of its own.

A busy worker does so between two steps of its solve; one that is stopped, dead, or stuck in native code does not. A
worker that is cold, because it is still loading or compiling kernels, is given longer: the compiler blocks it for
seconds, on a busy machine for many. It notes that in shared memory, and each step of the compiler counts as a
heartbeat.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.context import SpawnContext
from typing import Any, NamedTuple

EVERY_S = 0.25
"""Wall seconds between two heartbeats."""
SILENT_S = 3.0
"""A worker without a heartbeat for so long does not respond: longer than any solver step on a loaded machine."""
STUCK_S = 15.0
"""A worker without a heartbeat for so long is killed, so that another one can replace it."""
COLD_SILENT_S = 60.0
"""The same as SILENT_S for a cold one: longer than any step of the compiler on a loaded machine."""
COLD_STUCK_S = 120.0
"""The same as STUCK_S for a cold one, times `patience`."""
_FIELDS = (
    3  # of one worker: its process id, its last heartbeat (monotonic, the same clock in all processes), whether cold
)


class _Worker(NamedTuple):
    pid: int
    heartbeat_s: float
    cold: bool


class WorkerHeartbeats:
    """The heartbeats of one pool of at most `workers` processes. `shared` is passed to each worker."""

    def __init__(self, context: SpawnContext, workers: int) -> None:
        self._next = context.Value("i", 0)
        self._heartbeats = context.Array("d", workers * _FIELDS, lock=False)
        self.shared: tuple[Any, Any] = (self._next, self._heartbeats)

    @property
    def begun(self) -> bool:
        """Return whether a worker has ever sent a heartbeat."""
        return any(self._workers())

    @property
    def cold(self) -> bool:
        """Return whether a worker is loading or compiling kernels now."""
        return any(worker.cold for worker in self._workers())

    @property
    def warm(self) -> int:
        """Return how many workers have loaded all kernels."""
        return sum(not worker.cold for worker in self._workers())

    def is_cold(self, pid: int) -> bool:
        """Return whether this worker is loading or compiling kernels now."""
        return any(worker.cold for worker in self._workers() if worker.pid == pid)

    def answer(self) -> bool:
        """Return whether all workers that have started exist, and one of them has sent a heartbeat lately."""
        if self.gone():
            return False
        now = time.monotonic()
        return any(
            now - worker.heartbeat_s < (COLD_SILENT_S if worker.cold else SILENT_S) for worker in self._workers()
        )

    def silent_for_s(self) -> float:
        """Return the wall seconds since the last heartbeat of any worker; infinite before the first."""
        return time.monotonic() - max((worker.heartbeat_s for worker in self._workers()), default=float("-inf"))

    def gone(self) -> bool:
        """Return whether a worker that has sent a heartbeat no longer exists."""
        return any(not _exists(worker.pid) for worker in self._workers())

    def kill_stuck(self, patience: float = 1.0) -> None:
        """Kill workers without a heartbeat for STUCK_S, or COLD_STUCK_S times patience while cold."""
        now = time.monotonic()
        for worker in self._workers():
            if now - worker.heartbeat_s > (COLD_STUCK_S * patience if worker.cold else STUCK_S):
                with suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGKILL)

    def _workers(self) -> Iterator[_Worker]:
        for at in range(0, len(self._heartbeats), _FIELDS):
            pid, heartbeat_s, cold = self._heartbeats[at : at + _FIELDS]
            if heartbeat_s > 0:
                yield _Worker(int(pid), heartbeat_s, bool(cold))


class WorkerHeartbeat:
    """In a worker: its own row among the heartbeats."""

    def __init__(self, next_worker: Any, rows: Any) -> None:
        with next_worker.get_lock():
            self._at, next_worker.value = next_worker.value * _FIELDS, next_worker.value + 1
        self._heartbeats = rows
        self.set_cold(True)
        rows[self._at] = os.getpid()

    def beat(self) -> None:
        """Send a heartbeat."""
        self._heartbeats[self._at + 1] = time.monotonic()

    def beat_for_ever(self) -> None:
        """Send heartbeats for ever, in a thread of its own."""
        while True:
            self.beat()
            time.sleep(EVERY_S)

    def set_cold(self, cold: bool) -> None:
        """Set whether this worker is loading or compiling kernels."""
        self._heartbeats[self._at + 2] = cold

    def note_compiling(self, depth: int) -> None:
        """Note a step of the compiler, with so many kernels begun and not ended."""
        self.set_cold(depth > 0)
        self.beat()


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
