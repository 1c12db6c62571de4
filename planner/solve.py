"""`plan()`: the call that everything above the planner uses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.emit import emit
from planner.plans import Plan, PlanStatus
from planner.problem import Past, problem_of
from planner.reference import algorithm_1
from planner.scenario import Scenario
from planner.solution import Observer, ignore
from planner.stopping import AnyOf, MaxIterations, RelativeGain, StoppingRule

Array = NDArray[np.float64]


def converged() -> AnyOf:
    """The default stopping rule: less than 0.01 % gained, or 50 iterations."""
    return AnyOf(MaxIterations(50), RelativeGain(1e-4))


def plan(
    scenario: Scenario,
    *,
    past: Past | None = None,
    warm_start_m: Array | None = None,
    stop: StoppingRule | None = None,
    observer: Observer = ignore,
    clock: Callable[[], float] | None = None,
    **identity: Any,
) -> Plan:
    """Plan bandwidth, association and trajectories for `scenario`; always feasible, anytime.

    past: rates achieved before slot 0 (they count in the utility). warm_start_m: (U, N, 2) feasible paths to begin
    from, in metres. stop: when to return what has been found (default: converged). observer: called after each
    iteration. clock: fills `solve_ms`. identity: `id`, `revision`, `cause`, `parent` of the plan; the id defaults to
    a digest of the inputs. Raises ValueError for shapes that do not fit the scenario.
    """
    began = clock() if clock else 0.0
    past, stop = past or Past(), stop or converged()
    problem = problem_of(scenario, past)
    solution = algorithm_1(problem, stop, warm_start_m, observer)
    status = PlanStatus.CANCELLED if stop.interrupts else PlanStatus.SUCCEEDED
    made = emit(scenario, past, problem, solution, method="paper", status=status, **identity)
    return made.model_copy(update={"solve_ms": (clock() - began) * 1e3}) if clock else made
