"""What a planner process is: it beats from its first moment, loads the solver, then takes one job after the other.

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
from skyfolio.api.plans.job_board import Board
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.api.plans.liveness import Place
from skyfolio.planner import PlanStatus, ReplanError, UnreachableEndError


class _Here:
    """The board of this process, if it is a worker."""

    board: Board
    watching: ExitStack


def begin_worker(board: Board, niceness: int, *beats: Any) -> None:
    """Make this process a worker, with all kernels loaded before it takes its first job.

    `beats` (`liveness.Beats.shared`) is where it shows that it is alive, and that it compiles, now or whenever it does.
    niceness: how much it stands back when there are fewer cores than workers.
    """
    _Here.board = board
    place = Place(*beats)
    threading.Thread(target=place.beat_for_ever, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches the group; the service ends workers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(niceness)
    with kernels.compiling(lambda _: place.beat()):
        kernels.prepare()
    place.set_cold(False)
    _Here.watching = ExitStack()  # for as long as it lives: what was not rehearsed is told when it is compiled
    _Here.watching.enter_context(kernels.compiling(place.note_compiling))


def ready() -> int:
    """Nothing but this worker's process id: who gets it knows that a worker is warm."""
    return os.getpid()


def _end_with_parent() -> None:
    """A worker of a service that was killed would wait for jobs forever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def run(job: Job, token: int) -> Solved:
    """Solve one job; whatever goes wrong is in what comes back."""
    from skyfolio.api.plans.solving import solve  # noqa: PLC0415 - the parent process never loads it

    _Here.board.begin(token)
    try:
        made = solve(job, _Here.board, token)
    except (UnreachableEndError, ReplanError) as error:
        return Solved(status=PlanStatus.INFEASIBLE, error=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not break the pool
        return Solved(status=PlanStatus.FAILED, error=f"{type(error).__name__}: {error}")
    finally:
        _Here.board.end(token)
    return Solved(
        status=made.status,
        plan=made.model_dump_json(),
        summary=made.summary.model_dump_json(),
        iterations=len(made.history),
        solve_ms=made.solve_ms or 0.0,
    )
