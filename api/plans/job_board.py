"""Shared state of each job between service and planner process: stop flag, progress, best plan so far."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from multiprocessing.context import SpawnContext
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from pydantic import BaseModel

from skyfolio.planner import Iteration

_FIELDS = 5  # of a row: worker's process id, when it began, iterations, utility, mean sum rate


class Progress(BaseModel):
    """How far a running solve is: the best feasible plan so far is worth this much. Rates in bit/s."""

    iterations: int
    utility_bps: float
    mean_sum_rate_bps: float


class Worker(NamedTuple):
    """The process that runs a job: its id, 0 when there is none, and the monotonic second when it began, 0 before."""

    pid: int
    began_s: float


class Board(Protocol):
    """What a job writes while it is solved, wherever it runs, and asks whether it should stop."""

    def stopped(self, token: int) -> bool:
        """Return whether the job has been asked to stop."""
        ...

    def note(self, token: int, iteration: Iteration) -> None:
        """Note how far the job is."""
        ...

    def show(self, token: int, plan: str) -> None:
        """Publish the best plan so far, as JSON."""
        ...


class JobBoard:
    """Rows of shared memory, one for each job by its token; best plans are files, replaced whole.

    Each worker receives it when it starts. A worker may be killed at any moment: nothing here is locked.
    """

    def __init__(self, context: SpawnContext, jobs: int, folder: Path) -> None:
        self._stop: Any = context.Array("b", jobs, lock=False)
        self._rows: Any = context.Array("d", jobs * _FIELDS, lock=False)
        self._folder = folder

    def clear(self, token: int) -> None:
        """Reset the row of this token for a new job, which waits."""
        self._stop[token] = 0
        self._rows[token * _FIELDS : (token + 1) * _FIELDS] = [0.0] * _FIELDS

    # -- written by the service, read by the worker -------------------------------------------------------------------

    def stop(self, token: int) -> None:
        """Ask the job to return the best plan it has."""
        self._stop[token] = 1

    def stopped(self, token: int) -> bool:
        """Return whether the job has been asked to stop."""
        return bool(self._stop[token])

    # -- written by the worker, read by the service -------------------------------------------------------------------

    def begin(self, token: int) -> None:
        """Note that this process runs the job."""
        self._file(token).unlink(missing_ok=True)
        self._rows[token * _FIELDS : token * _FIELDS + 2] = [os.getpid(), time.monotonic()]

    def end(self, token: int) -> None:
        """Note that this process no longer runs the job."""
        self._rows[token * _FIELDS] = 0
        self._file(token).unlink(missing_ok=True)

    def worker(self, token: int) -> Worker:
        """Return who runs the job."""
        pid, began_s = self._rows[token * _FIELDS : token * _FIELDS + 2]
        return Worker(int(pid), began_s)

    def note(self, token: int, iteration: Iteration) -> None:
        """Note how far the job is."""
        at = token * _FIELDS
        self._rows[at + 2 : at + _FIELDS] = [iteration.iteration, iteration.utility_bps, iteration.mean_sum_rate_bps]

    def progress(self, token: int) -> Progress | None:
        """Return what the job has reached, None before its first iteration."""
        iterations, utility, rate = self._rows[token * _FIELDS + 2 : (token + 1) * _FIELDS]
        if not iterations:
            return None
        return Progress(iterations=int(iterations), utility_bps=utility, mean_sum_rate_bps=rate)

    def show(self, token: int, plan: str) -> None:
        """Publish the best plan so far, as JSON."""
        file = self._file(token)
        new = file.with_suffix(".new")
        new.write_text(plan, encoding="utf-8")
        new.replace(file)

    def best(self, token: int) -> str | None:
        """Return the plan that was published last, None while there is none. Reads a file: not for the event loop."""
        with suppress(FileNotFoundError):
            return self._file(token).read_text(encoding="utf-8")
        return None

    def _file(self, token: int) -> Path:
        return self._folder / f"{token}.json"
