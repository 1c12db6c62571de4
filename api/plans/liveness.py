"""Whether worker processes answer: each beats in shared memory, from a thread of its own, whatever it is solving.

A busy worker beats between two steps of its solve; one that is stopped, dead, or stuck in native code does not. One
that is cold, because it still loads or compiles kernels, is given longer: the compiler holds it for seconds, on a busy
machine for many. It says so in shared memory, and each step of the compiler counts as a beat.
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
"""Wall seconds between two beats."""
SILENT_S = 3.0
"""A worker that has not beaten for so long does not answer: longer than any solver step on a loaded machine."""
STUCK_S = 15.0
"""A worker that has not beaten for so long is killed, so that another one can take its place."""
COLD_SILENT_S = 60.0
"""The same as SILENT_S for a cold one: longer than any step of the compiler on a loaded machine."""
COLD_STUCK_S = 120.0
"""The same as STUCK_S for a cold one, times `patience`."""
_FIELDS = (
    3  # of one worker: its process id, when it beat last (monotonic, the same clock in all processes), whether cold
)


class _Worker(NamedTuple):
    pid: int
    beat_s: float
    cold: bool


class Beats:
    """The beats of one pool of at most `workers` processes. `shared` is what each worker gets."""

    def __init__(self, context: SpawnContext, workers: int) -> None:
        self._next = context.Value("i", 0)
        self._beats = context.Array("d", workers * _FIELDS, lock=False)
        self.shared: tuple[Any, Any] = (self._next, self._beats)

    @property
    def begun(self) -> bool:
        """Whether a worker has ever beaten."""
        return any(self._workers())

    @property
    def cold(self) -> bool:
        """Whether a worker loads or compiles kernels now."""
        return any(worker.cold for worker in self._workers())

    @property
    def warm(self) -> int:
        """How many workers have all kernels."""
        return sum(not worker.cold for worker in self._workers())

    def is_cold(self, pid: int) -> bool:
        """Whether this worker loads or compiles kernels now."""
        return any(worker.cold for worker in self._workers() if worker.pid == pid)

    def answer(self) -> bool:
        """Whether all that have begun are there, and one of them has beaten lately."""
        if self.gone():
            return False
        now = time.monotonic()
        return any(now - worker.beat_s < (COLD_SILENT_S if worker.cold else SILENT_S) for worker in self._workers())

    def silent_for_s(self) -> float:
        """Wall seconds since the worker that beat last did; infinite before any has."""
        return time.monotonic() - max((worker.beat_s for worker in self._workers()), default=float("-inf"))

    def gone(self) -> bool:
        """Whether a worker that has beaten is no longer there."""
        return any(not _exists(worker.pid) for worker in self._workers())

    def kill_stuck(self, patience: float = 1.0) -> None:
        """Kill who has not beaten for STUCK_S, COLD_STUCK_S times patience when cold: its pool breaks, is made anew."""
        now = time.monotonic()
        for worker in self._workers():
            if now - worker.beat_s > (COLD_STUCK_S * patience if worker.cold else STUCK_S):
                with suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGKILL)

    def _workers(self) -> Iterator[_Worker]:
        for at in range(0, len(self._beats), _FIELDS):
            pid, beat_s, cold = self._beats[at : at + _FIELDS]
            if beat_s > 0:
                yield _Worker(int(pid), beat_s, bool(cold))


class Place:
    """In a worker: its place among the beats."""

    def __init__(self, next_worker: Any, beats: Any) -> None:
        with next_worker.get_lock():
            self._at, next_worker.value = next_worker.value * _FIELDS, next_worker.value + 1
        self._beats = beats
        self.set_cold(True)
        beats[self._at] = os.getpid()

    def beat(self) -> None:
        """Now."""
        self._beats[self._at + 1] = time.monotonic()

    def beat_for_ever(self) -> None:
        """For a thread of its own."""
        while True:
            self.beat()
            time.sleep(EVERY_S)

    def set_cold(self, cold: bool) -> None:
        """Say whether it loads or compiles kernels from now on."""
        self._beats[self._at + 2] = cold

    def note_compiling(self, depth: int) -> None:
        """A step of the compiler, with so many kernels begun and not ended."""
        self.set_cold(depth > 0)
        self.beat()


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
