"""Whether worker processes answer: each beats in shared memory, from a thread of its own, whatever it is solving.

A busy worker beats between two steps of its solve; one that is stopped, dead, or stuck in native code does not.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from multiprocessing.context import SpawnContext
from typing import Any

EVERY_S = 0.25
"""Wall seconds between two beats."""
SILENT_S = 3.0
"""A worker that has not beaten for so long does not answer: longer than any solver step on a loaded machine."""
STUCK_S = 15.0
"""A worker that has not beaten for so long is killed, so that another one can take its place."""
_FIELDS = 2  # of one worker: its process id, and when it beat last (monotonic, the same clock in all processes)


class Beats:
    """The beats of one pool of at most `workers` processes. `shared` is what each worker gets."""

    def __init__(self, context: SpawnContext, workers: int) -> None:
        self._next = context.Value("i", 0)
        self._beats = context.Array("d", workers * _FIELDS, lock=False)
        self.shared: tuple[Any, Any] = (self._next, self._beats)

    @property
    def begun(self) -> bool:
        """Whether a worker has ever beaten."""
        return float(self._beats[1]) > 0

    def silent_for_s(self) -> float:
        """Wall seconds since the worker that beat last did; infinite before any has."""
        last = float(max(self._beats[1::_FIELDS]))
        return time.monotonic() - last if last > 0 else float("inf")

    def gone(self) -> bool:
        """Whether a worker that has beaten is no longer there."""
        return any(pid and not _exists(int(pid)) for pid in self._beats[0::_FIELDS])

    def kill_stuck(self) -> None:
        """Kill who has not beaten for STUCK_S: its pool breaks, and is made anew."""
        limit = time.monotonic() - STUCK_S
        for pid, at in zip(self._beats[0::_FIELDS], self._beats[1::_FIELDS], strict=True):
            if pid and at < limit:
                with suppress(ProcessLookupError):
                    os.kill(int(pid), signal.SIGKILL)


def beat(next_worker: Any, beats: Any) -> None:
    """In a worker: take a place and beat for ever."""
    with next_worker.get_lock():
        at, next_worker.value = next_worker.value * _FIELDS, next_worker.value + 1
    beats[at] = os.getpid()
    while True:
        beats[at + 1] = time.monotonic()
        time.sleep(EVERY_S)


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
