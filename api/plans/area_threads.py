"""Areas of a large fleet planned at the same time, by threads of this process.

The planner owns no threads: it hands over tasks (`planner.areas`) and waits for what they find. Nearly all that a task
does is done by kernels that hold no lock of the interpreter, so that threads use as many cores as processes would, and
nothing has to be started, loaded or copied. They work in any process: in a command, in a worker of the service, which
is killed with all that it does, and in a worker of a Dask cluster, which may not start processes.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from types import TracebackType
from typing import Any, Self

from skyfolio.planner import AnyOf, StopToken, converged
from skyfolio.planner.areas.blocks import Task
from skyfolio.planner.stopping import StoppingRule

ASK_EVERY_S = 0.2
"""How often it is asked whether to stop, by the thread that planned: who is asked need not be safe for threads."""
IN_WORKERS = 5
"""How much the threads of the service's workers stand back: they fill all cores, and replans in flight come first."""


class AreaThreads:
    """Runs the tasks of `planner.plan(run_areas=...)`; a context manager.

    asked_to_stop: whether tasks should return what they have; called by the caller's thread alone. at_once: how many
    tasks (default: one for each core that this process may use). niceness: how much the threads stand back. told:
    called with how many tasks have ended so far.
    """

    def __init__(
        self,
        asked_to_stop: Callable[[], bool] = lambda: False,
        *,
        at_once: int | None = None,
        niceness: int = 0,
        told: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._asked, self._told = asked_to_stop, told
        self._halt = threading.Event()
        self._ended = 0
        self.at_once = at_once or cores()
        self._pool = ThreadPoolExecutor(
            self.at_once, thread_name_prefix="area", initializer=_stand_back, initargs=(niceness,)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the threads: tasks that run stop at their next step, those that wait are dropped."""
        self._halt.set()
        self._pool.shutdown(cancel_futures=True)

    def __call__(self, tasks: Sequence[Task]) -> list[Any]:
        """Return what each task found, in order. Raises what the first one raised that failed."""
        futures = [self._pool.submit(task.run, AnyOf(converged(), StopToken(self._halt.is_set))) for task in tasks]
        waiting = set(futures)
        while waiting:
            done, waiting = wait(waiting, timeout=ASK_EVERY_S, return_when=FIRST_COMPLETED)
            if self._asked() or any(future.exception() for future in done):
                self._halt.set()
            if done:
                self._ended += len(done)
                self._told(self._ended)
        return [future.result() for future in futures]


def interrupting(stop: StoppingRule) -> Callable[[], bool]:
    """Return a question whether an interrupting rule speaks."""
    return lambda: stop([]) and stop.interrupts


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _stand_back(niceness: int) -> None:
    """Make this thread nicer, where threads have priorities of their own."""
    if niceness and sys.platform == "linux":
        thread = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + niceness)
