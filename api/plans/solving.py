"""How a planner process solves a job, and shows how far it is. The service itself never imports it."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import sqrt

from skyfolio.api.plans.area_threads import IN_WORKERS, AreaThreads, interrupting
from skyfolio.api.plans.job_board import Board
from skyfolio.api.plans.jobs import Job, Solved
from skyfolio.planner import (
    AnyOf,
    Budget,
    Cause,
    Deadline,
    PinError,
    Plan,
    PlanStatus,
    ReplanError,
    RobustnessError,
    Scenario,
    StopToken,
    Trial,
    UnreachableEndError,
    assess,
    converged,
    explain,
    plan,
    preview,
    reassociate,
    replan,
)
from skyfolio.planner.areas.size import is_large
from skyfolio.planner.fast.optimise import default_starts
from skyfolio.planner.problem import problem_of

SHOW_EVERY_S = 0.25
SOLVING_PER_SHOWING = 19.0
"""The best plan so far is shown at most four times a second, and in at most a twentieth of the time."""

RESOLVE_S = 10.0
"""An explanation begins no further resolve after so long; what it says besides takes seconds for the largest fleets."""
STARTS_PER_ROOT = 2.0
"""Starts per square root of UAVs x users x slots: 11 for two UAVs, four users and four slots, 24 from size 144 on."""

Clock = Callable[[], float]
"""Returns monotonic seconds."""


class BestSoFar:
    """Makes and shows the best plan so far, seldom enough that solving hardly notices. `clock`: monotonic seconds."""

    def __init__(self, show: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._show, self._clock = show, clock
        self._make: Callable[[], Plan] | None = None
        self._due_s = clock() + SHOW_EVERY_S

    def offer(self, make: Callable[[], Plan]) -> None:
        """Offer a better solution."""
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


def attempt(job: Job, board: Board, token: int, clock: Clock = time.monotonic) -> Solved:
    """Do one job, showing on the board how far it is. Every failure is part of the result."""
    try:
        return work(job, board, token, clock)
    except (UnreachableEndError, ReplanError, PinError, RobustnessError) as error:
        return Solved(status=PlanStatus.INFEASIBLE, error=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not break the pool
        return Solved(status=PlanStatus.FAILED, error=f"{type(error).__name__}: {error}")


def work(job: Job, board: Board, token: int, clock: Clock = time.monotonic) -> Solved:
    """Do one job, showing on the board how far it is. Raises ValueError when the problem has no solution."""
    tasks = {
        "plan": _planned,
        "reassociate": _reassociated,
        "explain": _explained,
        "preview": _previewed,
        "assess": _assessed,
    }
    return tasks[job.task](job, board, token, clock)


def solve(job: Job, board: Board, token: int, clock: Clock = time.monotonic) -> Plan:
    """Plan or replan, showing on the board how far it is. Raises ValueError when the problem has no solution."""
    best = BestSoFar(lambda text: board.show(token, text), clock)

    def asked_to_stop() -> bool:
        best.show_if_due()
        return board.stopped(token)

    stop = AnyOf(converged(), StopToken(asked_to_stop), Deadline(job.deadline_s, clock=clock))
    options = {
        "stop": stop,
        "clock": clock,
        "observer": lambda iteration: board.note(token, iteration),
        "offer": best.offer,
        **job.identity,
        "cause": Cause.model_validate(job.identity.get("cause", {})),
    }
    with AreaThreads(interrupting(stop), niceness=IN_WORKERS) as run_areas:
        if job.previous is not None:
            previous = Plan.model_validate_json(job.previous)
            return replan(previous, **job.request, n_starts=job.starts, run_areas=run_areas, **options)
        assert job.scenario is not None  # noqa: S101 - one of the two is always given
        scenario = Scenario.model_validate_json(job.scenario)
        starts = job.starts or starts_of(scenario, job.most_starts)
        return plan(scenario, **job.request, n_starts=starts, run_areas=run_areas, **options)


def _planned(job: Job, board: Board, token: int, clock: Clock) -> Solved:
    return _as_solved(solve(job, board, token, clock))


def _reassociated(job: Job, board: Board, token: int, clock: Clock) -> Solved:
    del board, token  # it takes milliseconds: there is nothing to show, and nothing to stop
    began_s = clock()
    identity = {**job.identity, "cause": Cause.model_validate(job.identity.get("cause", {}))}
    made = reassociate(_previous(job), **job.request, **identity)
    return _as_solved(made.model_copy(update={"solve_ms": (clock() - began_s) * 1e3}))


def _as_solved(made: Plan) -> Solved:
    return Solved(
        status=made.status,
        plan=made.model_dump_json(),
        summary=made.summary.model_dump_json(),
        iterations=len(made.history),
        solve_ms=made.solve_ms or 0.0,
    )


def _explained(job: Job, board: Board, token: int, clock: Clock) -> Solved:
    until = Deadline(min(RESOLVE_S, job.deadline_s), clock=clock)
    found = explain(_previous(job), budget=Budget(**job.request), stop=lambda: board.stopped(token) or until([]))
    return Solved(status=PlanStatus.SUCCEEDED, report=found.model_dump_json(), complete=found.complete)


def _previewed(job: Job, board: Board, token: int, clock: Clock) -> Solved:
    asked_to_stop = StopToken(lambda: board.stopped(token))
    stop = AnyOf(converged(), asked_to_stop, Deadline(job.deadline_s, clock=clock))
    scenario = None if job.scenario is None else Scenario.model_validate_json(job.scenario)
    starts = job.starts if scenario is None else job.starts or starts_of(scenario, job.most_starts)
    with AreaThreads(interrupting(stop), niceness=IN_WORKERS) as run_areas:
        options = {"n_starts": starts, "stop": stop, "run_areas": run_areas, **job.request}
        seen = preview(_previous(job), scenario=scenario, **options)
    return Solved(status=PlanStatus.SUCCEEDED, report=seen.model_dump_json())


def _assessed(job: Job, board: Board, token: int, clock: Clock) -> Solved:
    until = Deadline(job.deadline_s, clock=clock)
    trial = Trial.model_validate(job.request)
    found = assess(_previous(job), trial, stop=lambda: board.stopped(token) or until([]))
    return Solved(status=PlanStatus.SUCCEEDED, report=found.model_dump_json(), complete=found.complete)


def _previous(job: Job) -> Plan:
    assert job.previous is not None  # noqa: S101 - as `Job` says
    return Plan.model_validate_json(job.previous)


def starts_of(scenario: Scenario, most: int) -> int | None:
    """Return how many starts a plan is climbed from by default: few where few already find the best, by size.

    Large fleets are planned by areas, which know by themselves.
    """
    if is_large(scenario):
        return None
    size = len(scenario.uavs) * len(scenario.users) * scenario.slots
    return max(1, min(most, int(STARTS_PER_ROOT * sqrt(size)), default_starts(problem_of(scenario))))
