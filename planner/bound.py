"""The certificate: a utility that no feasible plan can exceed.

Every bound here has two parts. Per slot: what weighted sum rate can the fleet give at most, wherever it can be by then
(reachability here, interference that cannot be escaped in `crowding`, branch and bound over positions of small fleets
in `branch_and_bound.py`)? And from slots to the utility: `sum` increases in every slot's sum rate, so the slot bounds
are put into it as they are; `per_user` and `pooled` are concave in the rate table, so each tangent plane lies above
them, and the greatest value of a tangent plane over all feasible rate tables is a weighted sum rate per slot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize_scalar

from skyfolio.planner.areas.size import is_large_problem
from skyfolio.planner.arrays import Array
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.optimistic import optimistic_rates_kbps
from skyfolio.planner.problem import Problem
from skyfolio.planner.utility import soft_mean

TANGENTS, TANGENTS_OF_A_REPLAN = 12, 3
"""How many tangent planes are tried: each costs one assignment per slot, and a fleet in flight waits for its replan."""
STEP_ACCURACY = 0.003
"""Of the line search between two of them, as a share of the way."""
SMALL, SMALL_CROWD = 200_000, 10_000
"""U K N up to which every plan gets a bound from tangent planes; where crowding bounds all slots, that proves more."""
CROWD = 4
"""From how many UAVs on the crowding bound is worth its milliseconds."""


def upper_bound_kbps(problem: Problem, rates_kbps: Array | None = None) -> float:
    """Return an upper bound of the utility of every feasible plan, in kbit/s: the one that every plan gets.

    rates_kbps: (K, N) of a plan; what is proven about others is tighter for a good one, and true for any. Crowding
    speaks of one realisation of the channel and of users that stay: rates averaged over draws are bounded by
    reachability, draw by draw, and those of users on tracks slot by slot.
    """
    if is_large_problem(problem):
        from skyfolio.planner.areas.ceiling import slot_ceilings_kbps  # noqa: PLC0415 - small fleets go without

        return lifted_kbps(problem, slot_ceilings_kbps(problem, rates_kbps))
    crowded = np.full(problem.n_slots, np.inf)
    if problem.n_uavs >= CROWD and may_crowd(problem):
        from skyfolio.planner.crowding.bound import crowded_slot_bounds_kbps  # noqa: PLC0415 - small fleets go without

        crowded = crowded_slot_bounds_kbps(problem, rates_kbps)
    mean_bound, known = lifted_kbps(problem, _with_reach(problem, crowded)), bool(np.isfinite(crowded).all())
    if problem.kind == "sum" or problem.mu == 0.0 or problem.snr_gain.size > (SMALL_CROWD if known else SMALL):
        return mean_bound
    tangents = TANGENTS_OF_A_REPLAN if problem.past_kbps.shape[1] and not known else TANGENTS
    return min(mean_bound, tangent_bound_kbps(problem, best_tables(optimistic_rates_kbps(problem)), tangents))


def may_crowd(problem: Problem) -> bool:
    """Return whether `crowding` speaks of this problem: of one realisation of an inverse square, users that stay."""
    still = problem.user_m.shape[1] == 1 and not problem.spread_m2.any()
    return still and not problem.draws.size and problem.bends is None


def reachability_bound_kbps(problem: Problem) -> float:
    """Return an upper bound of the utility of every feasible plan, in kbit/s, from reachability alone.

    In slot n a UAV is within `n D_max` of its start, close enough to its end if it has one, and in the area. Each pair
    gets the nearest own and the farthest interfering distance that this allows. Past slots count as they were.
    """
    return bound_of_pairs_kbps(problem, optimistic_rates_kbps(problem))


def bound_of_pairs_kbps(problem: Problem, pair_kbps: Array) -> float:
    """Return an upper bound of the utility, in kbit/s, if no pair has more than `pair_kbps` (U, K, N) in a slot."""
    tables = best_tables(pair_kbps)
    weights = np.repeat(problem.weight[:, None], problem.n_slots, axis=1)
    mean_bound = lifted_kbps(problem, (weights * tables(weights)).sum(axis=0))
    if problem.kind == "sum" or problem.mu == 0.0:
        return mean_bound
    return min(mean_bound, tangent_bound_kbps(problem, tables, TANGENTS)) if pair_kbps.size <= SMALL else mean_bound


def slot_bounds_kbps(problem: Problem) -> Array:
    """Return the reachability bound of the weighted sum rate of each slot: (N,) kbit/s."""
    weights = np.repeat(problem.weight[:, None], problem.n_slots, axis=1)
    bounds: Array = (weights * best_tables(optimistic_rates_kbps(problem))(weights)).sum(axis=0)
    return bounds


def _with_reach(problem: Problem, crowded: Array) -> Array:
    """Return the lesser of both bounds of each slot, as far as reachability can be the lesser one: (N,).

    Little can be reached in the first slots and, by those who must be somewhere at the end, in the last ones: it is
    looked at from both sides, until it proves less than is known.
    """
    bounds = crowded.copy()
    if not np.isfinite(crowded).any():
        return slot_bounds_kbps(problem)
    weights = problem.weight[:, None]

    def lower(slots: Iterable[int]) -> None:
        for n in slots:
            rates = optimistic_rates_kbps(problem, np.array([n]))
            reached = float((weights * best_tables(rates)(weights)).sum())
            bounds[n] = min(bounds[n], reached)
            if reached > crowded[n]:
                break

    lower(range(problem.n_slots))
    if np.isfinite(problem.end_m).any() or not np.isfinite(crowded).all():
        lower(range(problem.n_slots - 1, -1, -1))
    return bounds


def lifted_kbps(problem: Problem, per_slot_kbps: Array) -> float:
    """From bounds (N,) of the weighted sum rate of each slot to a bound of the utility.

    `sum` increases in each of them; the other utilities are at most the mean sum rate by Jensen's inequality.
    """
    past = np.nansum(problem.weight[:, None] * problem.past_kbps, axis=0)
    if problem.has_demand:
        per_slot_kbps = np.minimum(per_slot_kbps, asked_for_kbps(problem, problem.weight[:, None] * problem.there))
    counted = np.concatenate([past, per_slot_kbps[problem.counted_from :]])
    return soft_mean(counted, problem.mu if problem.kind == "sum" else 0.0)


def asked_for_kbps(problem: Problem, weights: Array) -> Array:
    """Return what the weighted sum rate (weights: (K, N)) of each slot comes to if all have what they ask for: (N,)."""
    most = np.where(weights > 0.0, problem.demand_kbps[:, None], 0.0)
    worth = weights * most if problem.has_demand else np.inf
    total: Array = np.broadcast_to(worth, weights.shape).sum(axis=0)
    return total


def tangent_bound_kbps(problem: Problem, tables: Callable[[Array], Array], tries: int) -> float:
    """Return the least bound from tangent planes of a concave utility, in kbit/s.

    `tables(w)` must give rates (K, N) whose weighted sum `<w, R>` no feasible rate table exceeds. For any R*,
    G(R) <= G(R*) + <w, R - R*> with w the gradient at R*. The R* tried are those of the Frank-Wolfe method, whose own
    optimality gap is this very bound.
    """
    point = tables(np.repeat(problem.weight[:, None], problem.n_slots, axis=1))
    least = np.inf
    for _ in range(tries):
        weights = rate_weights(problem, point)
        vertex = tables(weights)
        value = problem.utility_kbps(point)
        gain = float((weights * (vertex - point)).sum())
        if problem.has_demand:
            most = np.minimum((weights * vertex).sum(axis=0), asked_for_kbps(problem, weights))
            gain = float((most - (weights * point).sum(axis=0)).sum())
        least = min(least, value + gain)
        point = point + best_step(problem, point, vertex) * (vertex - point)
    return float(least)


def best_step(problem: Problem, point: Array, vertex: Array) -> float:
    """Return the share in [0, 1] of the way to the vertex with the greatest utility, which is concave along it."""

    def loss_kbps(share: float) -> float:
        return -problem.utility_kbps(point + share * (vertex - point))

    return float(minimize_scalar(loss_kbps, bounds=(0.0, 1.0), method="bounded", options={"xatol": STEP_ACCURACY}).x)


def best_tables(pair_kbps: Array) -> Callable[[Array], Array]:
    """For weights (K, N): the rate table (K, N) of greatest weighted sum if each pair can have up to `pair_kbps`.

    Under (6a) and (6c) a UAV's whole band to its best user is the most a slot can give, to distinct users: a linear
    assignment per slot.
    """

    def tables(weights: Array) -> Array:
        best = np.zeros(weights.shape)
        for n in range(pair_kbps.shape[2]):
            rates = pair_kbps[:, :, n]
            uav, user = linear_sum_assignment(rates * weights[:, n], maximize=True)
            best[user, n] = rates[uav, user]
        return best

    return tables
