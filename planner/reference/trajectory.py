"""Problem (a7): the convex surrogate of the trajectory problem around the last iterate (eqs. 14-21)."""

from __future__ import annotations

from itertools import combinations

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.reference.objective import least_rates, maximise_with_least_rates
from skyfolio.planner.reference.zones import half_planes, outside
from skyfolio.planner.sinr import spectral_efficiency

UNIT_M = 100.0
"""Lengths are solved in units of 100 m: the interior point method wants numbers near 1."""
STEP_MARGIN = 1e-6
"""Steps are planned this much (relatively) shorter than D_max: the interior point method rounds."""


def steered(problem: Problem, allocated_hz: Array, paths_m: Array) -> Array:
    """Solve (a7) once around `paths_m`: (U, N, 2) metres. Raises SubproblemError.

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
    distance2 = problem.distances2(paths_m)[:, users, slots]
    snr = problem.snr_gain[:, users, slots] / distance2  # of every UAV at the expansion point

    pair_rates = surrogate_rates(allocated_hz[:, users, slots], snr, lower, upper)
    scatter = np.zeros((problem.n_users * problem.n_slots, pairs))
    scatter[users * problem.n_slots + slots, np.arange(pairs)] = 1.0
    rates = cp.reshape(scatter @ pair_rates, (problem.n_users, problem.n_slots), order="C")
    constraints: list[cp.Constraint] = []
    for u in range(n_uavs):
        constraints += _distance_bounds(problem, u, paths_m[u], (users, slots), q[u], lower[u], upper[u])
        constraints += _motion(problem, u, paths_m[u], q[u])
    constraints += _separation(problem, paths_m, q)
    now_kbps = (allocated_hz * spectral_efficiency(problem, paths_m)).sum(axis=0) / 1e3
    maximise_with_least_rates(problem, rates, np.minimum(least_rates(problem), now_kbps), constraints)
    return np.stack([each.value for each in q]) * UNIT_M


def surrogate_rates(allocated_hz: Array, snr: Array, lower: cp.Expression, upper: cp.Expression) -> cp.Expression:
    """Return sum_u a b f_eta of eq. (16) for each pair, (pairs,) kbit/s; every array is (U, pairs).

    snr is that of the expansion point, lower and upper are relative to it, so both are 1 there.
    """
    weight = allocated_hz / 1e3
    received = cp.log(cp.sum(cp.multiply(snr, lower), axis=0) + 1) / np.log(2)  # first term of (16), over sigma^2
    interference = snr.sum(axis=0) - snr + 1.0  # at the expansion point, for each serving UAV
    constant = (weight * np.log2(interference)).sum(axis=0)  # second term
    per_snr = weight / interference / np.log(2)
    slope = snr * (per_snr.sum(axis=0) - per_snr)  # third term: d/d upper_i, over all serving UAVs u != i
    return cp.multiply(weight.sum(axis=0), received) - constant - cp.sum(cp.multiply(slope, upper - 1), axis=0)


def _distance_bounds(
    problem: Problem,
    u: int,
    path_m: Array,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
    q: cp.Variable,
    lower: cp.Expression,
    upper: cp.Expression,
) -> list[cp.Constraint]:
    """Return eqs. (19) and (20), both divided by d^2 at the expansion point `path_m` (N, 2)."""
    users, slots = pairs
    moment = np.minimum(slots, problem.user_m.shape[1] - 1)
    centre = problem.user_m[users, moment] / UNIT_M
    towards = path_m[slots] / UNIT_M - centre  # q^l - c
    height2 = (problem.altitude_m[u] / UNIT_M) ** 2 + problem.spread_m2[users, moment] / UNIT_M**2
    distance2 = (towards**2).sum(axis=1) + height2
    own2 = cp.sum(cp.square(q[slots] - centre), axis=1) + height2
    linear2 = distance2 + 2 * cp.sum(cp.multiply(towards, q[slots] - path_m[slots] / UNIT_M), axis=1)
    return [
        2 - lower >= cp.multiply(1 / distance2, own2),  # (19)
        cp.multiply(1 / distance2, linear2) >= cp.inv_pos(upper),  # (20)
    ]


def _motion(problem: Problem, u: int, path_m: Array, q: cp.Variable) -> list[cp.Constraint]:
    """Return (6d), (6f) and (6g), and beyond the letter: end positions, leaving, no-fly zones."""
    flying = int(problem.n_flying[u])
    constraints = [q[0] == problem.start_m[u] / UNIT_M]  # (6g)
    if flying > 1:
        step = problem.step_m[u] / UNIT_M * (1 - STEP_MARGIN)
        longest = np.maximum(step, np.linalg.norm(np.diff(path_m[:flying], axis=0), axis=1) / UNIT_M)
        constraints += [
            cp.norm(q[1:flying] - q[: flying - 1], axis=1) <= longest,  # (6d)
            *_wind(problem, u, path_m[:flying], q[:flying]),
            q[1:flying] >= problem.low_m / UNIT_M,  # (6f)
            q[1:flying] <= problem.high_m / UNIT_M,
        ]
        zones = [(normal, offset / UNIT_M) for normal, offset in half_planes(problem, path_m[:flying])]
        constraints += outside(zones, q[:flying])
    if flying < problem.n_slots:
        constraints.append(q[flying:] == np.repeat(path_m[flying - 1 : flying], problem.n_slots - flying, 0) / UNIT_M)
    if np.isfinite(problem.end_m[u]).all() and flying > 1:
        constraints.append(q[flying - 1] == problem.end_m[u] / UNIT_M)
    return constraints


def _wind(problem: Problem, u: int, path_m: Array, q: cp.Expression) -> list[cp.Constraint]:
    """Return the limit of the airspeed: steps lie in a disc around what the wind does in a slot."""
    air = problem.air
    if air is None or not np.isfinite(air.still_mps[u]):
        return []
    drift = air.wind_mps * air.slot_s / UNIT_M
    now = np.linalg.norm(np.diff(path_m, axis=0) / UNIT_M - drift, axis=1)
    longest = np.maximum(air.still_mps[u] * air.slot_s / UNIT_M * (1 - STEP_MARGIN), now)
    return [cp.norm(q[1:] - q[:-1] - np.tile(drift, (len(now), 1)), axis=1) <= longest]


def _separation(problem: Problem, paths_m: Array, q: list[cp.Variable]) -> list[cp.Constraint]:
    """Return eq. (21): constraint (6e), linearised around the last iterate, while both UAVs fly."""
    if problem.separation_m == 0:
        return []
    constraints = []
    for u, j in combinations(range(problem.n_uavs), 2):
        both = min(problem.n_flying[u], problem.n_flying[j])
        apart = (paths_m[u] - paths_m[j])[1:both] / UNIT_M
        if len(apart):
            constraints.append(
                -np.sum(apart**2, axis=1) + 2 * cp.sum(cp.multiply(apart, q[u][1:both] - q[j][1:both]), axis=1)
                >= (problem.separation_m / UNIT_M) ** 2
            )
    return constraints
