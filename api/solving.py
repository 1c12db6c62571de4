"""What a planner process does: solve one job after the other, and show how far each is.

Imported by workers, so nothing of the web, the database or the fleet is imported here.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import sqrt
from multiprocessing import connection, parent_process
from typing import Any

from api import kernels
from api.board import Board
from api.liveness import Place
from planner import (
    AnyOf,
    Cause,
    Deadline,
    Plan,
    PlanStatus,
    Scenario,
    StopToken,
    converged,
    plan,
    replan,
)
from planner.fast.optimise import default_starts
from planner.problem import problem_of

SHOW_EVERY_S = 0.25
SOLVING_PER_SHOWING = 19.0
"""The best plan so far is shown at most four times a second, and in at most a twentieth of the time."""

STARTS_PER_ROOT = 2.0
"""Starts per square root of UAVs x users x slots: 11 for two UAVs, four users and four slots, 24 from size 144 on."""


class _Here:
    """The board of this process, if it is a worker."""

    board: Board
    watching: ExitStack


@dataclass(frozen=True, kw_only=True)
class Job:
    """One solve, as JSON: a scenario to plan, or a previous plan to replan with `request` (as `planner.replan`).

    `starts`: how many the optimiser climbs from; None lets it choose by size, a plan's then at most `most_starts`.
    """

    scenario: str | None = None
    previous: str | None = None
    request: dict[str, Any] = field(default_factory=dict)
    identity: dict[str, Any] = field(default_factory=dict)
    deadline_s: float = 60.0
    starts: int | None = None
    most_starts: int = 64


@dataclass(frozen=True, kw_only=True)
class Solved:
    """What a worker hands back: a plan as JSON with its status, or how it failed."""

    status: PlanStatus
    plan: str = ""
    summary: str = ""
    iterations: int = 0
    solve_ms: float = 0.0
    error: str | None = None


class BestSoFar:
    """Makes and shows the best plan so far, seldom enough that solving hardly notices. `clock`: monotonic seconds."""

    def __init__(self, show: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._show, self._clock = show, clock
        self._make: Callable[[], Plan] | None = None
        self._due_s = clock() + SHOW_EVERY_S

    def offer(self, make: Callable[[], Plan]) -> None:
        """There is a better one."""
        self._make = make

    def show_if_due(self) -> None:
        """Show the best one, unless it has been shown or the last time was just now."""
        began = self._clock()
        if self._make is None or began < self._due_s:
            return
        make, self._make = self._make, None
        self._show(make().model_dump_json())
        now = self._clock()
        self._due_s = now + max(SHOW_EVERY_S, SOLVING_PER_SHOWING * (now - began))


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
    _Here.board.begin(token)
    try:
        made = _solve(job, token)
    except ValueError as error:
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


def _solve(job: Job, token: int) -> Plan:
    board = _Here.board
    best = BestSoFar(lambda text: board.show(token, text), time.monotonic)

    def asked_to_stop() -> bool:
        best.show_if_due()
        return board.stopped(token)

    options = {
        "stop": AnyOf(converged(), StopToken(asked_to_stop), Deadline(job.deadline_s, clock=time.monotonic)),
        "clock": time.perf_counter,
        "observer": lambda iteration: board.note(token, iteration),
        "offer": best.offer,
        **job.identity,
        "cause": Cause.model_validate(job.identity.get("cause", {})),
    }
    if job.previous is not None:
        return replan(Plan.model_validate_json(job.previous), **job.request, n_starts=job.starts, **options)
    assert job.scenario is not None  # noqa: S101 - one of the two is always given
    scenario = Scenario.model_validate_json(job.scenario)
    return plan(scenario, n_starts=job.starts or starts_of(scenario, job.most_starts), **options)


def starts_of(scenario: Scenario, most: int) -> int:
    """How many starts a plan is climbed from when nobody says: by size, few where a few already find the best."""
    size = len(scenario.uavs) * len(scenario.users) * scenario.slots
    return max(1, min(most, int(STARTS_PER_ROOT * sqrt(size)), default_starts(problem_of(scenario))))
