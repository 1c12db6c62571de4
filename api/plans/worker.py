"""A planner process: it sends heartbeats from the start, loads the solver, then takes one job after the other.

Nothing of the web, the database or the fleet is imported here, and the solver only once the process shows that it is
alive: loading it takes a second, or a minute where it must be compiled first.
"""

from __future__ import annotations

import os
import signal
import threading
from contextlib import ExitStack
from multiprocessing import connection, parent_process
from typing import Any

from skyfolio.api.common import kernels
from skyfolio.api.plans.job_board import Board, JobBoard
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.liveness import WorkerHeartbeat
from skyfolio.planner import PinError, PlanStatus, ReplanError, RobustnessError, UnreachableEndError


class _WorkerState:
    """The job board of this process, if it is a worker."""

    board: JobBoard
    watching: ExitStack


def begin_worker(board: JobBoard, niceness: int, *heartbeats: Any) -> None:
    """Make this process a worker, with all kernels loaded before it takes its first job.

    heartbeats (`liveness.WorkerHeartbeats.shared`): where it shows that it is alive, and that it is compiling.
    niceness: how much it stands back when there are fewer cores than workers.
    """
    _WorkerState.board = board
    heartbeat = WorkerHeartbeat(*heartbeats)
    threading.Thread(target=heartbeat.beat_for_ever, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches the group; the service ends workers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(niceness)
    with kernels.compiling(lambda _: heartbeat.beat()):
        kernels.load_all()
    heartbeat.set_cold(False)
    _WorkerState.watching = ExitStack()  # for as long as it lives: what was not rehearsed is noted when it is compiled
    _WorkerState.watching.enter_context(kernels.compiling(heartbeat.note_compiling))


def ready() -> int:
    """Return this worker's process id; the caller then knows that a worker is warm."""
    return os.getpid()


def _end_with_parent() -> None:
    """End this process when the service has ended: it would wait for jobs forever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def run(job: Job, token: int) -> Solved:
    """Solve one job. Every failure is part of the result."""
    _WorkerState.board.begin(token)
    try:
        return solved(job, _WorkerState.board, token)
    finally:
        _WorkerState.board.end(token)


def solved(job: Job, board: Board, token: int) -> Solved:
    """Solve one job, showing on a board how far it is. Every failure is part of the result."""
    from skyfolio.api.plans.solving import work  # noqa: PLC0415 - the parent process never loads it

    try:
        return work(job, board, token)
    except (UnreachableEndError, ReplanError, PinError, RobustnessError) as error:
        return Solved(status=PlanStatus.INFEASIBLE, error=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not break the pool
        return Solved(status=PlanStatus.FAILED, error=f"{type(error).__name__}: {error}")
