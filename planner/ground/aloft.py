"""Solutions over ground: with altitudes, and with the links that are best up there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import as_asked, linked, served_rates_bps
from skyfolio.planner.ground.choosing import chosen_altitudes
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.links import seen_aloft
from skyfolio.planner.ground.room import room_over
from skyfolio.planner.ground.shortening import safe_over
from skyfolio.planner.ground.thrift import saving
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution

MET = 1.0 - 1e-9
"""A minimum rate counts as met from this share of it on."""


def raised(problem: Problem, ground: Ground, solution: Solution, known_m: Array | None = None) -> Solution:
    """Return the solution at the lowest altitudes that keep clear of the ground, its paths cut short where none do.

    Users who get more up there than they ask for leave the rest of the band free. known_m: paths (U, N, 2) that were
    safe before, metres. Raises UnreachableEndError where no safe paths were found.
    """
    paths_m = safe_over(problem, ground, solution.paths_m, known_m)
    aloft = replace(solution, paths_m=paths_m, altitudes_m=room_over(ground, paths_m).floor_m)
    return as_asked(_seen(problem, ground, aloft), aloft) if problem.has_demand else aloft


def at_its_best(
    problem: Problem,
    ground: Ground,
    solution: Solution,
    climb: Callable[[Problem, Array], Solution] | None,
    known_m: Array | None = None,
) -> Solution:
    """Return the solution with the altitudes and links that are best over the ground.

    climb: climbs from paths with the gains of links as they are aloft; None: the links stay as they are.
    known_m: as for `raised`.
    """
    first = raised(problem, ground, solution, known_m)
    if climb is None:
        return _with_history(problem, ground, [first])
    steps = [first, _with_links(problem, ground, first)]
    seen = _seen(saving(problem, ground, solution.paths_m), ground, steps[-1])
    again = raised(problem, ground, climb(seen, first.paths_m), first.paths_m)
    steps.append(_linked(problem, ground, again))
    return _with_history(problem, ground, steps)


def _linked(problem: Problem, ground: Ground, solution: Solution) -> Solution:
    """Return the solution with links that are best at its altitudes, then altitudes for these links, and links anew."""
    made = _with_links(problem, ground, solution)
    if not ground.chooses:
        return made
    altitudes_m = chosen_altitudes(problem, ground, room_over(ground, made.paths_m), made)
    if made.altitudes_m is not None and np.array_equal(altitudes_m, made.altitudes_m):
        return made
    return _with_links(problem, ground, replace(made, altitudes_m=altitudes_m))


def _with_links(problem: Problem, ground: Ground, solution: Solution) -> Solution:
    seen = _seen(problem, ground, solution)
    best = as_asked(seen, linked(seen, solution.paths_m))
    return replace(solution, serving=best.serving, bandwidth_hz=best.bandwidth_hz)


def _seen(problem: Problem, ground: Ground, solution: Solution) -> Problem:
    assert solution.altitudes_m is not None  # noqa: S101 - made by `raised`
    return seen_aloft(problem, ground, solution.paths_m, solution.altitudes_m)


def _with_history(problem: Problem, ground: Ground, steps: list[Solution]) -> Solution:
    """Return the best of these steps; its history holds those that were better than all before them."""
    best, rank = steps[0], (-np.inf, -np.inf)
    history: list[Iteration] = []
    for step in steps:
        seen = _seen(problem, ground, step)
        rates = served_rates_bps(seen, step) / 1e3
        unmet = int(((rates < problem.min_kbps[:, None] * MET) & problem.there).sum())
        reached = (-float(unmet), problem.utility_kbps(rates))
        if reached <= rank:
            continue
        if reached[1] < rank[1]:
            history.clear()  # more least rates are met now: another count begins
        best, rank = step, reached
        history.append(
            Iteration(
                iteration=len(history) + 1,
                utility_bps=reached[1] * 1e3,
                mean_sum_rate_bps=float(rates.sum(axis=0).mean()) * 1e3,
            )
        )
    return replace(best, history=history)
