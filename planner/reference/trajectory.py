"""Problem (a7): the convex surrogate of the trajectory problem around the last iterate (eqs. 14-21)."""

from __future__ import annotations

from itertools import combinations

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from planner.channel import squared_distances
from planner.problem import Problem
from planner.reference.objective import concave_utility, solve

Array = NDArray[np.float64]
UNIT_M = 100.0
"""Lengths are solved in units of 100 m: the interior point method wants numbers near 1."""


def steered(problem: Problem, allocated_hz: Array, paths_m: Array) -> Array:
    """Solve (a7) once around `paths_m`: (U, N, 2) metres.

    allocated_hz: (U, K, N) Hz, the product a b. A pair (k, n) with a b = 0 for every UAV does not enter the
    objective, so its eta are left out; nothing else differs from the letter. The auxiliaries are scaled by their
    expansion point: lower = eta_lower / eta_lower^l, upper = eta_upper / eta_upper^l, with eta^l = d^-2 at `paths_m`.
    """
    users, slots = np.nonzero(allocated_hz.sum(axis=0) > 0)
    n_uavs, pairs = problem.n_uavs, len(users)
    if pairs == 0:
        return paths_m
    q = [cp.Variable((problem.n_slots, 2)) for _ in range(n_uavs)]
    lower = cp.Variable((n_uavs, pairs), nonneg=True)
    upper = cp.Variable((n_uavs, pairs), nonneg=True)
    distance2 = squared_distances(paths_m, problem.user_m, problem.altitude_m)[:, users, slots] / UNIT_M**2
    snr = problem.snr_gain[:, users, slots] / (distance2 * UNIT_M**2)  # of every UAV at the expansion point

    rates = _surrogate_rates(problem, allocated_hz[:, users, slots], snr, lower, upper, (users, slots))
    constraints: list[cp.Constraint] = []
    for u in range(n_uavs):
        last = paths_m[u] / UNIT_M
        towards = last[slots] - problem.user_m[users] / UNIT_M  # q^l - c
        own2 = cp.sum(cp.square(q[u][slots] - problem.user_m[users] / UNIT_M), axis=1)
        height2 = (problem.altitude_m[u] / UNIT_M) ** 2
        constraints += [
            cp.multiply(distance2[u], 2 - lower[u]) >= own2 + height2,  # (19)
            distance2[u] + 2 * cp.sum(cp.multiply(towards, q[u][slots] - last[slots]), axis=1)
            >= cp.multiply(distance2[u], cp.inv_pos(upper[u])),  # (20)
            q[u][0] == problem.start_m[u] / UNIT_M,  # (6g)
            q[u] >= problem.low_m / UNIT_M,  # (6f)
            q[u] <= problem.high_m / UNIT_M,
        ]
        if problem.n_slots > 1:
            constraints.append(cp.norm(q[u][1:] - q[u][:-1], axis=1) <= problem.step_m[u] / UNIT_M)  # (6d)
    constraints += _separation(problem, paths_m, q)
    solve(concave_utility(problem, rates), constraints)
    return np.stack([each.value for each in q]) * UNIT_M


def _surrogate_rates(
    problem: Problem,
    allocated_hz: Array,
    snr: Array,
    lower: cp.Variable,
    upper: cp.Variable,
    where: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> cp.Expression:
    """sum_u a b f_eta of eq. (16) as a (K, N) expression in kbit/s; every array is (U, pairs)."""
    weight = allocated_hz / 1e3
    total = weight.sum(axis=0)
    first = cp.multiply(total, cp.log(cp.sum(cp.multiply(snr, lower), axis=0) + 1)) / np.log(2)
    interference = snr.sum(axis=0) - snr + 1.0  # at the expansion point, for each serving UAV
    constant = (weight * np.log2(interference)).sum(axis=0)
    per_watt = weight / interference / np.log(2)
    slope = snr * (per_watt.sum(axis=0) - per_watt)  # d/d upper_i, over all serving UAVs u != i
    pair_rates = first - constant - cp.sum(cp.multiply(slope, upper - 1), axis=0)
    scatter = np.zeros((problem.n_users * problem.n_slots, len(total)))
    scatter[where[0] * problem.n_slots + where[1], np.arange(len(total))] = 1.0
    return cp.reshape(scatter @ pair_rates, (problem.n_users, problem.n_slots), order="C")


def _separation(problem: Problem, paths_m: Array, q: list[cp.Variable]) -> list[cp.Constraint]:
    """Eq. (21): constraint (6e), linearised around the last iterate."""
    if problem.separation_m == 0:
        return []
    constraints = []
    for u, j in combinations(range(problem.n_uavs), 2):
        apart = (paths_m[u] - paths_m[j]) / UNIT_M
        constraints.append(
            -np.sum(apart**2, axis=1) + 2 * cp.sum(cp.multiply(apart, q[u] - q[j]), axis=1)
            >= (problem.separation_m / UNIT_M) ** 2
        )
    return constraints
