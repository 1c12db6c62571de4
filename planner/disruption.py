"""Replans that change little: what a plan changes of the one it replaces, what that is priced, and the cheapest choice.

The price counts users and metres alike in kbit/s, on the scale of the utility, which is a mean over slots: one
`weight_kbps` for each user that another UAV serves throughout, and for each `METRES_PER_USER` that UAVs are off their
old paths throughout. A family of plans between the old and the new one is made, whatever the weight, and the one of the
greatest utility less its price is taken. As the family does not depend on the weight, more weight never changes more:
if A is best at the lower weight and B at the higher, adding up the two comparisons leaves B no more disruption than A.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner import fast
from skyfolio.planner.arrays import Array
from skyfolio.planner.changes import ReplanError
from skyfolio.planner.feasibility import MIN_RATE_ROUNDING
from skyfolio.planner.plans import Disruption, Plan
from skyfolio.planner.problem import Problem
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solution import Solution
from skyfolio.planner.stopping import StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError
from skyfolio.planner.utility import utility_kbps

Ints = NDArray[np.intp]
METRES_PER_USER = 100.0
"""So many metres off the old paths, summed over the UAVs, are priced like one user with another server."""
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""How far from the old to the new paths the plans lie on which every path is given."""
MOST_KEPT = 6
"""So many plans are tried in which some UAVs keep their old paths and the others climb anew."""


@dataclass(frozen=True, kw_only=True)
class Former:
    """The rest of the plan that a replan replaces, in the order of the new scenario, and the price of changing it.

    paths_m: (U, N, 2) metres, NaN for UAVs that it did not have; serving: (K, N), -1 where the UAV that served is gone
    or the user is new; served: (K, N), whether the user had bandwidth. weight_kbps: as in the module's docstring.
    """

    paths_m: Array
    serving: Ints
    served: NDArray[np.bool_]
    weight_kbps: float = 0.0


def former_of(previous: Plan, scenario: Scenario, at_slot: int, kept: set[str], weight_kbps: float) -> Former:
    """Return what is left of `previous` from `at_slot` on for the new `scenario`; kept: its UAVs that fly on.

    Raises ReplanError for a weight that is no price.
    """
    if not (np.isfinite(weight_kbps) and weight_kbps >= 0.0):
        raise ReplanError(f"disruption_weight: {weight_kbps} must be a finite number of kbit/s, at least 0")
    begin = at_slot - previous.first_slot
    nowhere = [(np.nan, np.nan)] * scenario.slots
    paths_m = [previous.trajectories_m[uav][begin:] if uav in kept else nowhere for uav in scenario.uav_ids]
    number = {uav: u for u, uav in enumerate(scenario.uav_ids) if uav in kept}
    new, silent = [""] * scenario.slots, [0.0] * scenario.slots
    rows = [previous.association[user][begin:] if user in previous.association else new for user in scenario.user_ids]
    serving = np.array([[number.get(uav, -1) for uav in row] for row in rows], dtype=np.intp)
    last = np.array([scenario.last_slot(uav) for uav in scenario.uavs])
    serving = np.where(np.arange(scenario.slots) <= last[serving], serving, -1)
    bands = previous.bandwidth_hz
    served = np.array([bands[user][begin:] if user in bands else silent for user in scenario.user_ids]) > 0.0
    return Former(paths_m=np.array(paths_m), serving=serving, served=served, weight_kbps=weight_kbps)


def disruption_of(former: Former, solution: Solution) -> Disruption:
    """Return what a solution changes of the former plan, and the price of that."""
    concerned = (former.serving >= 0) & (former.served | (solution.bandwidth_hz > 0.0))
    changed = concerned & (solution.serving != former.serving)
    apart_m = np.linalg.norm(solution.paths_m - former.paths_m, axis=2)
    slots = apart_m.shape[1]
    made = Disruption(
        user_slots_changed=int(changed.sum()),
        users_changed=int(changed.any(axis=1).sum()),
        path_changed_m=float(np.nansum(apart_m)) / slots,
        weight_kbps=former.weight_kbps,
        price_bps=0.0,
    )
    return made.model_copy(update={"price_bps": former.weight_kbps * 1e3 * _amount(made, slots)})


def _amount(made: Disruption, slots: int) -> float:
    """Return what the weight is multiplied with: users that change, and metres in their measure, slot by slot."""
    return made.user_slots_changed / slots + made.path_changed_m / METRES_PER_USER


@dataclass(frozen=True)
class _Rated:
    """A solution, in how many slots of how many users it misses a minimum rate, its utility and its disruption."""

    solution: Solution
    unmet: int
    utility_kbps: float
    amount: float


def least_disruptive(problem: Problem, former: Former, best: Solution, stop: StoppingRule, seed: int) -> Solution:
    """Return the plan of the greatest utility less its price among `best`, the rest of the old plan, and between them.

    Plans that change more than `best`, or leave more minimum rates unmet than another, are out, whatever the weight.
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
    unmet = min(one.unmet for one in family)
    eligible = [one for one in family if one.unmet == unmet]
    return max(eligible, key=lambda one: (one.utility_kbps - former.weight_kbps * one.amount, -one.amount)).solution


def _rated(problem: Problem, former: Former, solution: Solution) -> _Rated:
    rates_kbps = fast.served_rates_bps(problem, solution) / 1e3
    unmet = int((rates_kbps < problem.min_kbps[:, None] * (1.0 - MIN_RATE_ROUNDING)).sum())
    utility = utility_kbps(problem.counted_kbps(rates_kbps), problem.kind, problem.mu)
    amount = _amount(disruption_of(former, solution), problem.n_slots)
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
