"""`plan()`, the function that everything above the planner calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from skyfolio.planner import areas
from skyfolio.planner.areas.blocks import Task
from skyfolio.planner.areas.size import is_large
from skyfolio.planner.arrays import Array
from skyfolio.planner.disruption import Former, disruption_of
from skyfolio.planner.emit import emit
from skyfolio.planner.fast import as_asked
from skyfolio.planner.ground.aloft import at_its_best, raised
from skyfolio.planner.ground.ground import ground_of
from skyfolio.planner.little_change import least_disruptive
from skyfolio.planner.methods import AREAS, DEFAULT_METHOD, Method, method_of
from skyfolio.planner.pinning import PinError, Pinned, pinned
from skyfolio.planner.pins import Pins
from skyfolio.planner.plans import Iteration, Plan, PlanStatus
from skyfolio.planner.problem import Past, Problem, problem_of
from skyfolio.planner.scenario import Point, Scenario
from skyfolio.planner.solution import Observer, Solution, ignore
from skyfolio.planner.stopping import AnyOf, MaxIterations, RelativeGain, StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError
from skyfolio.planner.unsuited import UnsuitedError


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
    pins: Pins | None = None,
    current_m: Mapping[str, Sequence[Point]] | None = None,
    former: Former | None = None,
    stop: StoppingRule | None = None,
    observer: Callable[[Iteration], None] = _ignore,
    offer: Callable[[Callable[[], Plan]], None] = _ignore,
    clock: Callable[[], float] | None = None,
    run_areas: Callable[[Sequence[Task]], list[Any]] | None = None,
    around_m: Sequence[Point] | None = None,
    **identity: Any,
) -> Plan:
    """Plan bandwidth, association and trajectories for `scenario`; always flyable, anytime.

    method: a name in `METHODS`; a large fleet (`areas.size`) on the mean channel is planned by `areas` instead of the
    default method, unless something is asked of it that only the default method does. n_starts: how many starts the
    search climbs from, by areas in the first round (default: by size, 32 at the letter's), drawn from `seed`: the same
    inputs give the same plan. past: rates achieved before slot 0 (they count in the utility).
    warm_start_m: (U, N, 2) paths to begin from, in metres. pins: parts that are fixed. current_m: the
    paths that pinned UAVs are on (default: they hover). former: the plan that this one replaces, and the price of
    changing it. stop: when to return what has been found (default: converged). observer: called after each iteration
    that counts. offer: called then with what makes the plan reached so far, `running`, when it is wanted. clock: fills
    `solve_ms`. run_areas: runs the tasks of `areas` at the same time, and returns their results in order (default: one
    after the other, here). around_m: the places at which something is different since the warm start was planned;
    `areas` plans anew only around there, other methods everywhere. identity: `id`, `revision`, `cause`, `parent` and
    `dropped_pins` of the plan; the id defaults to a digest of the inputs.
    Raises UnreachableEndError, which names the UAVs, when no paths to all end positions, or none clear of the ground,
    are found, PinError for pins
    that cannot be kept, UnsuitedError for an unknown method and for what a method cannot do, and ValueError for shapes
    that do not fit the scenario.
    """
    began = clock() if clock else 0.0
    past, stop = past or Past(), stop or converged()
    held = pinned(scenario, pins or Pins(), current_m)
    method = _suited(scenario, method, held, former)
    problem = _held(problem_of(scenario, past), held)
    _check(problem.hover().shape, n_starts, warm_start_m)
    _require_able(method, held, former)
    _require_plain_users(method, scenario)
    inputs = [method, n_starts, seed, None if warm_start_m is None else warm_start_m.tobytes(), *_asked(held, former)]

    def emitted(solution: Solution, status: PlanStatus) -> Plan:
        if ground is not None and solution.altitudes_m is None:
            solution = raised(problem, ground, solution, warm_start_m)
        changed = disruption_of(former, solution) if former else None
        told = {"pins": held.pins, "disruption": changed, "method": method, "status": status}
        return emit(scenario, past, problem, solution, inputs, ground=ground, **told, **identity)

    ground = ground_of(scenario)
    told = _told(observer, offer, lambda solution: emitted(solution, PlanStatus.RUNNING))
    try:
        solution = _solver(method, run_areas, around_m)(problem, stop, warm_start_m, told, n_starts=n_starts, seed=seed)
        if former is not None:
            solution = as_asked(problem, least_disruptive(problem, former, solution, stop, seed))
        if ground is not None:
            climb = _climbing_again(method, former, stop, seed)
            solution = at_its_best(problem, ground, solution, climb, warm_start_m)
    except UnreachableEndError as error:
        raise _explained(error.named(scenario.uav_ids), held) from None
    made = emitted(solution, PlanStatus.CANCELLED if stop.interrupts else PlanStatus.SUCCEEDED)
    return made.model_copy(update={"solve_ms": (clock() - began) * 1e3}) if clock else made


def _suited(scenario: Scenario, method: str, held: Pinned, former: Former | None) -> str:
    """Return the method: by areas for large fleets where the default one was asked for and nothing else of it."""
    wanted = method == DEFAULT_METHOD and not held.pins and not (former and former.weight_kbps > 0.0)
    return AREAS if wanted and is_large(scenario) else method


def _solver(
    method: str, run_areas: Callable[[Sequence[Task]], list[Any]] | None, around_m: Sequence[Point] | None
) -> Method:
    if method != AREAS:
        return method_of(method)
    return partial(areas.optimise, run=run_areas, around_m=None if around_m is None else np.array(around_m))


def _climbing_again(
    method: str, former: Former | None, stop: StoppingRule, seed: int
) -> Callable[[Problem, Array], Solution] | None:
    """Return what climbs from paths once more; None for methods, and prices, that have said what links there are."""
    if method != DEFAULT_METHOD or (former and former.weight_kbps > 0.0):
        return None
    return lambda problem, paths_m: method_of(method)(problem, stop, paths_m, ignore, n_starts=1, seed=seed)


def _held(problem: Problem, held: Pinned) -> Problem:
    """Return the problem with its pins; without any it is the same."""
    return replace(problem, pinned_m=held.paths_m, pinned_to=held.serving) if held.pins else problem


def _asked(held: Pinned, former: Former | None) -> list[object]:
    """Return what pins and price add to the inputs that distinguish plans: nothing where there are none."""
    price = [former.weight_kbps] if former and former.weight_kbps > 0.0 else []
    return [*([held.pins.model_dump_json()] if held.pins else []), *price]


def _require_able(method: str, held: Pinned, former: Former | None) -> None:
    """Refuse what only the default method can do. Raises PinError or UnsuitedError."""
    if method == DEFAULT_METHOD:
        return
    if held.pins:
        raise PinError(f"pins: only the method {DEFAULT_METHOD!r} keeps pins, not {method!r}")
    if former and former.weight_kbps > 0.0:
        raise UnsuitedError(f"disruption_weight: only the method {DEFAULT_METHOD!r} has one, not {method!r}")


def _require_plain_users(method: str, scenario: Scenario) -> None:
    """Refuse users that the letter's own algorithm does not know; `areas` does so itself.

    Raises UnsuitedError.
    """
    if method != "paper":
        return
    for k, user in enumerate(scenario.users):
        for name in ("arrives_at_slot", "leaves_at_slot", "weight", "demand_bps"):
            if getattr(user, name) is not None:
                raise UnsuitedError(f"users.{k}.{name}: the method 'paper' does not know it; '{DEFAULT_METHOD}' does")


def _explained(error: UnreachableEndError, held: Pinned) -> ValueError:
    """Return the error, or with pinned paths one that tells of them."""
    if not held.pins.paths_m or error.blocked.by == "ground":
        return error
    who = ", ".join(map(repr, held.pins.paths_m))
    return PinError(
        f"pins: no paths were found on which the other UAVs keep min_separation_m from the pinned {who}, stay within "
        "area_m and out of no_fly, and reach their ends (eqs. 6d-6f)"
    )


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
        raise UnsuitedError(f"n_starts: {n_starts} must be at least 1")
    if warm_start_m is not None and (warm_start_m.shape != shape or not np.isfinite(warm_start_m).all()):
        raise ValueError(f"warm_start_m: must hold finite numbers of shape {shape}, not {warm_start_m.shape}")
