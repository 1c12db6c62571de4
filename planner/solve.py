"""`plan()`, the function that everything above the planner calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.emit import emit
from skyfolio.planner.methods import DEFAULT_METHOD, method_of
from skyfolio.planner.plans import Iteration, Plan, PlanStatus
from skyfolio.planner.problem import Past, problem_of
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solution import Observer, Solution
from skyfolio.planner.stopping import AnyOf, MaxIterations, RelativeGain, StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError


def converged() -> AnyOf:
    """Return the default stopping rule: a gain below 0.01 %, or 50 iterations."""
    return AnyOf(MaxIterations(50), RelativeGain(1e-4))


def _ignore(what: object) -> None:
    """Ignore every iteration: the default observer."""


def plan(
    scenario: Scenario,
    *,
    method: str = DEFAULT_METHOD,
    n_starts: int | None = None,
    seed: int = 0,
    past: Past | None = None,
    warm_start_m: Array | None = None,
    stop: StoppingRule | None = None,
    observer: Callable[[Iteration], None] = _ignore,
    offer: Callable[[Callable[[], Plan]], None] = _ignore,
    clock: Callable[[], float] | None = None,
    **identity: Any,
) -> Plan:
    """Plan bandwidth, association and trajectories for `scenario`; always flyable, anytime.

    method: a name in `METHODS`. n_starts: how many starts the fast path climbs from (default: by size, 32 at the
    letter's), drawn from `seed`: the same inputs give the same plan. past: rates achieved before slot 0 (they count
    in the utility). warm_start_m: (U, N, 2) paths to begin from, in metres. stop: when to return what has been found
    (default: converged). observer: called after each iteration that counts. offer: called then with what makes
    the plan reached so far, `running`, when it is wanted. clock: fills `solve_ms`. identity: `id`,
    `revision`, `cause`, `parent` of the plan; the id defaults to a digest of the inputs.
    Raises UnreachableEndError, which names the UAVs, when no paths to all end positions are found, and ValueError for
    an unknown method and for shapes that do not fit the scenario.
    """
    began = clock() if clock else 0.0
    past, stop = past or Past(), stop or converged()
    problem = problem_of(scenario, past)
    _check(problem.hover().shape, n_starts, warm_start_m)
    inputs = (method, n_starts, seed, None if warm_start_m is None else warm_start_m.tobytes())

    def emitted(solution: Solution, status: PlanStatus) -> Plan:
        return emit(scenario, past, problem, solution, inputs, method=method, status=status, **identity)

    told = _told(observer, offer, lambda solution: emitted(solution, PlanStatus.RUNNING))
    try:
        solution = method_of(method)(problem, stop, warm_start_m, told, n_starts=n_starts, seed=seed)
    except UnreachableEndError as error:
        raise error.named(scenario.uav_ids) from None
    made = emitted(solution, PlanStatus.CANCELLED if stop.interrupts else PlanStatus.SUCCEEDED)
    return made.model_copy(update={"solve_ms": (clock() - began) * 1e3}) if clock else made


def _told(
    observer: Callable[[Iteration], None],
    offer: Callable[[Callable[[], Plan]], None],
    emitted: Callable[[Solution], Plan],
) -> Observer:
    def told(iteration: Iteration, reached: Callable[[], Solution]) -> None:
        observer(iteration)
        offer(lambda: emitted(reached()))

    return told


def _check(shape: tuple[int, ...], n_starts: int | None, warm_start_m: Array | None) -> None:
    if n_starts is not None and n_starts < 1:
        raise ValueError(f"n_starts: {n_starts} must be at least 1")
    if warm_start_m is not None and (warm_start_m.shape != shape or not np.isfinite(warm_start_m).all()):
        raise ValueError(f"warm_start_m: must hold finite numbers of shape {shape}, not {warm_start_m.shape}")
