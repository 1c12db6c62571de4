"""Solutions over ground: with altitudes, and with the links that are best up there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

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
ROUGHLY, FAIRLY, FINELY = 3e-5, 2e-5, 3e-6
"""How near to the best links are taken, relatively: of what is compared, and of the best of it, by size."""
MOST_FINE_CELLS = 100_000
"""U K N up to which the last links are taken finely: above, that takes as long as the plan over level ground did."""


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
    first = _step(problem, ground, raised(problem, ground, solution, known_m))
    steps = Steps(first)
    if climb is None:
        return steps.solution()
    steps.offer(_linked(first, ROUGHLY))
    seen = seen_aloft(saving(problem, ground, solution.paths_m), ground, *_place(first.solution))
    again = raised(problem, ground, climb(seen, first.solution.paths_m), first.solution.paths_m)
    steps.offer(_linked(_step(problem, ground, again), ROUGHLY))
    if ground.chooses:
        best = steps.best.solution
        altitudes_m = chosen_altitudes(problem, ground, room_over(ground, best.paths_m), best)
        if not np.array_equal(altitudes_m, _place(best)[1]):
            steps.offer(_linked(_step(problem, ground, replace(best, altitudes_m=altitudes_m)), ROUGHLY))
    steps.offer(_linked(steps.best, FINELY if problem.snr_gain.size <= MOST_FINE_CELLS else FAIRLY))
    return steps.solution()


@dataclass(frozen=True)
class Step:
    """A solution on the way; seen: the problem whose rates at its paths are those at its altitudes."""

    solution: Solution
    seen: Problem
    rates_kbps: Array
    rank: tuple[float, float]
    """Greater is better: first fewer minimum rates unmet, then utility, kbit/s."""


class Steps:
    """The best of the steps so far, and the history: those that were better than all before them."""

    def __init__(self, first: Step) -> None:
        """Begin with a step."""
        self.best, self.history = first, [_iteration(1, first)]

    def offer(self, step: Step) -> None:
        """Take a step if it is better than all before."""
        if step.rank <= self.best.rank:
            return
        if step.rank[1] < self.best.rank[1]:
            self.history.clear()  # more least rates are met now: another count begins
        self.best = step
        self.history.append(_iteration(len(self.history) + 1, step))

    def solution(self) -> Solution:
        """Return the best solution with its history."""
        return replace(self.best.solution, history=self.history)


def _step(problem: Problem, ground: Ground, solution: Solution) -> Step:
    return _ranked(_seen(problem, ground, solution), solution)


def _ranked(seen: Problem, solution: Solution) -> Step:
    rates = served_rates_bps(seen, solution) / 1e3
    unmet = int(((rates < seen.min_kbps[:, None] * MET) & seen.there).sum())
    return Step(solution, seen, rates, (-float(unmet), seen.utility_kbps(rates)))


def _linked(step: Step, tolerance: float) -> Step:
    """Return the step with the links that are best at its places and altitudes."""
    near = linked(step.seen, step.solution.paths_m, near_kbps=step.rates_kbps, tolerance=tolerance)
    best = as_asked(step.seen, near)
    return _ranked(step.seen, replace(step.solution, serving=best.serving, bandwidth_hz=best.bandwidth_hz))


def _seen(problem: Problem, ground: Ground, solution: Solution) -> Problem:
    return seen_aloft(problem, ground, *_place(solution))


def _place(solution: Solution) -> tuple[Array, Array]:
    assert solution.altitudes_m is not None  # noqa: S101 - made by `raised`
    return solution.paths_m, solution.altitudes_m


def _iteration(number: int, step: Step) -> Iteration:
    mean = float(step.rates_kbps.sum(axis=0).mean())
    return Iteration(iteration=number, utility_bps=step.rank[1] * 1e3, mean_sum_rate_bps=mean * 1e3)
