"""Replans that change little: the plan of the greatest utility less the price of what it changes.

A family of plans between the old and the new one is made, whatever the weight; the best of them by the price at hand
are then improved by that price: users change UAVs and UAVs their paths only as far as each change is worth its price,
until none is. So the plan is a local optimum of what is priced, and never worth less than any plan of the family.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner import fast
from skyfolio.planner.arrays import Array
from skyfolio.planner.disruption import METRES_PER_USER, Former, amount_of, disruption_of
from skyfolio.planner.feasibility import MIN_RATE_ROUNDING
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution
from skyfolio.planner.stopping import StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError

Ints = NDArray[np.intp]
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""How far from the old to the new paths the plans lie on which every path is given."""
MOST_KEPT = 6
"""So many plans are tried in which some UAVs keep their old paths and the others climb anew."""


FAVOURITES = 2
"""So many plans of the family are improved by the price."""
ALIKE_M = 5.0
"""Plans with the same links are alike if their ways are this near to each other."""
BLURS_M = (10.0, 1.0, 0.1)
"""Metres are priced as if they began so gently, the last time by centimetres."""
ROUNDS = 12
"""Links and ways in turn, for each of those."""
ENOUGH = 1e-6
"""Relative: what a round must gain for another one."""


@dataclass(frozen=True)
class _Rated:
    """A solution, in how many slots of how many users it misses a minimum rate, its utility and its disruption."""

    solution: Solution
    unmet: int
    utility_kbps: float
    amount: float

    def rank(self, weight_kbps: float) -> tuple[int, float, float]:
        """Greater is better: minimum rates first, then utility less the price."""
        return -self.unmet, self.utility_kbps - weight_kbps * self.amount, -self.amount


def least_disruptive(problem: Problem, former: Former, best: Solution, stop: StoppingRule, seed: int) -> Solution:
    """Return the plan of the greatest utility less its price that is found between `best` and the rest of the old plan.

    Plans of the family that change more than `best` are out, and any that leave more minimum rates unmet than others.
    An interrupting rule ends the search with what there is; without one the outcome is the same for the same inputs.
    """
    if former.weight_kbps == 0.0:
        return best
    free = _rated(problem, former, best)
    family = [free]
    for solution in _family(problem, former, best, stop, seed):
        rated = _rated(problem, former, solution)
        if rated.amount <= free.amount:
            family.append(rated)
        if stop([]) and stop.interrupts:
            break
    weight = former.weight_kbps
    improved = (_improved(problem, former, one, stop) for one in _favourites(family, weight))
    return max(improved, key=lambda one: one.rank(weight)).solution


def _favourites(family: list[_Rated], weight_kbps: float) -> list[_Rated]:
    """Return the best of the family by the price that are not alike: from the like the same plan would come about."""
    chosen: list[_Rated] = []
    for one in sorted(family, key=lambda one: one.rank(weight_kbps), reverse=True):
        if len(chosen) < FAVOURITES and not any(_alike(one.solution, other.solution) for other in chosen):
            chosen.append(one)
    return chosen


def _alike(one: Solution, other: Solution) -> bool:
    """Return whether two plans have the same links, on ways within ALIKE_M."""
    mine, theirs = (np.where(plan.bandwidth_hz > 0.0, plan.serving, -1) for plan in (one, other))
    near = np.abs(one.paths_m - other.paths_m).max() <= ALIKE_M
    return bool(near) and np.array_equal(mine, theirs)


def _improved(problem: Problem, former: Former, start: _Rated, stop: StoppingRule) -> _Rated:
    """Return what links and ways in turn make of a plan, as long as its utility less its price grows."""
    weight = former.weight_kbps
    tolls = fast.Tolls(
        former_m=former.paths_m,
        serving=former.serving,
        served=former.served,
        per_metre=weight / METRES_PER_USER / problem.n_slots,
        per_user=weight / problem.n_slots,
    )
    best = start
    for blur_m in BLURS_M:
        climb = fast.PricedClimb(problem, tolls, blur_m)
        for _ in range(ROUNDS):
            if stop([]) and stop.interrupts:
                return best
            before = best
            for solution in climb.steps(best.solution):
                made = _rated(problem, former, solution)
                best = max(best, made, key=lambda one: one.rank(weight))
            gain = best.rank(weight)[1] - before.rank(weight)[1]
            if best.unmet == before.unmet and gain <= ENOUGH * abs(best.utility_kbps):
                break
    return best


def _rated(problem: Problem, former: Former, solution: Solution) -> _Rated:
    rates_kbps = fast.served_rates_bps(problem, solution) / 1e3
    unmet = int((rates_kbps < problem.min_kbps[:, None] * (1.0 - MIN_RATE_ROUNDING)).sum())
    utility = problem.utility_kbps(rates_kbps)
    amount = amount_of(disruption_of(former, solution), problem.n_slots)
    return _Rated(solution, unmet, utility, amount)


def _family(problem: Problem, former: Former, best: Solution, stop: StoppingRule, seed: int) -> Iterator[Solution]:
    """Return plans between the old and the new one, the least disruptive first, each as far as it can be flown."""
    old_m = _flown(problem, np.where(np.isnan(former.paths_m), best.paths_m, former.paths_m), best)
    kept_to = _kept_servers(problem, former)
    for share in SHARES:
        between_m = _flown(problem, old_m + share * (best.paths_m - old_m), best)
        for pinned_to in (kept_to, problem.pinned_to):
            yield from _climbed(problem, between_m, between_m, pinned_to, stop, seed)
    yield from _climbed(problem, old_m, problem.pinned_m, kept_to, stop, seed)
    moved_m = np.linalg.norm(best.paths_m - old_m, axis=2).sum(axis=1)
    for count in np.unique(np.linspace(problem.n_uavs - 1, 1, MOST_KEPT).astype(int))[::-1]:
        keeping = np.zeros(problem.n_uavs, dtype=bool)
        keeping[np.argsort(moved_m, kind="stable")[:count]] = True
        pinned_m = np.where(keeping[:, None, None], old_m, problem.pinned_m if problem.pinned_m.size else np.nan)
        wanted_m = np.where(keeping[:, None, None], old_m, best.paths_m)
        for pinned_to in (kept_to, problem.pinned_to):
            yield from _climbed(problem, wanted_m, pinned_m, pinned_to, stop, seed)


def _flown(problem: Problem, wanted_m: Array, best: Solution) -> Array:
    """Return the flyable paths (U, N, 2) that follow the wanted ones, or the best ones where those cannot be flown."""
    try:
        return fast.flyable(problem, wanted_m)
    except UnreachableEndError:
        return best.paths_m


def _kept_servers(problem: Problem, former: Former) -> Ints:
    """Return who serves whom, (K, N), when pins come first and the old servers stay where they can."""
    if not problem.pinned_to.size:
        return former.serving
    return np.where(problem.pinned_to >= 0, problem.pinned_to, former.serving)


def _climbed(
    problem: Problem, wanted_m: Array, pinned_m: Array, pinned_to: Ints, stop: StoppingRule, seed: int
) -> Iterator[Solution]:
    """Return the climb from these paths, (U, N, 2) metres, under these pins, if they can be flown."""
    if stop([]) and stop.interrupts:
        return
    held = replace(problem, pinned_m=pinned_m, pinned_to=pinned_to)
    try:
        yield fast.optimise(held, stop, wanted_m, n_starts=1, seed=seed)
    except UnreachableEndError:  # UAVs that keep their paths leave the others none: no plan of the family
        return
