"""Solves on a worker of a Dask cluster: the same work as in our own worker processes, told from afar.

What a job has reached is sent to the service as small events; the best plan so far, which may be large, is fetched from
here when somebody asks for it. The worker runs one job in each of its threads.
"""

from __future__ import annotations

import threading
import time
from functools import cache
from typing import Any

from skyfolio.api.common import kernels
from skyfolio.api.common.planner_identity import require_planner
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.planner import Iteration

TELL_EVERY_S = 0.25

_boards: dict[str, RemoteBoard] = {}
"""The jobs that this process runs, by name."""


class RemoteBoard:
    """What `job_board.JobBoard` is in our own workers: stop flag, progress, best plan so far. The token is ignored."""

    def __init__(self, name: str, topic: str) -> None:
        from distributed import get_worker  # noqa: PLC0415 - an extra

        self._name, self._topic, self._worker = name, topic, get_worker()
        self._stop = threading.Event()
        self._told_s = 0.0
        self.best: str | None = None

    def tell(self, **told: Any) -> None:
        """Send the service an event about this job."""
        self._worker.log_event(self._topic, {"job": self._name, "worker": self._worker.address, **told})

    def stop(self) -> None:
        """Ask the job to return the best plan it has."""
        self._stop.set()

    def stopped(self, token: int) -> bool:  # noqa: ARG002 - as in `JobBoard`
        """Return whether the job has been asked to stop."""
        return self._stop.is_set()

    def note(self, token: int, iteration: Iteration) -> None:  # noqa: ARG002
        """Note how far the job is, a few times a second."""
        now_s = time.monotonic()
        if now_s >= self._told_s + TELL_EVERY_S:
            self._told_s = now_s
            self.tell(reached=[iteration.iteration, iteration.utility_bps, iteration.mean_sum_rate_bps])

    def show(self, token: int, plan: str) -> None:  # noqa: ARG002
        """Keep the best plan so far, as JSON."""
        self.best = plan


@cache
def _load_kernels() -> None:
    kernels.load_all()


def run_remotely(job: Job, name: str, topic: str, planner: str) -> Solved:
    """Solve one job. Every failure of the solve is part of the result; raises OtherPlannerError."""
    from skyfolio.api.plans.solving import attempt  # noqa: PLC0415 - the service loads no solver

    require_planner(planner)
    _load_kernels()
    board = _boards[name] = RemoteBoard(name, topic)
    try:
        board.tell(began=True)
        return attempt(job, board, 0)
    finally:
        del _boards[name]


def stop_job(name: str) -> None:
    """Ask a job of this worker to stop, if it still runs."""
    if name in _boards:
        _boards[name].stop()


def best_of(name: str) -> str | None:
    """Return the best plan so far of a job of this worker, as JSON; None while there is none."""
    return _boards[name].best if name in _boards else None
