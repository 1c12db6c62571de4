"""Problem (a5): bandwidth for a given (relaxed or binary) association."""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.reference.objective import least_rates, maximise_with_least_rates

RESIDUE = 1e-5
"""Shares of a band below this are what an interior point method leaves of a zero."""


def best_bandwidth(problem: Problem, association: Array, efficiency: Array) -> Array:
    """Solve (a5): B >= 0 for given A and Q, under (6c); (U, K, N) Hz.

    Only the product x = a b matters, so the variable is x in shares of `B_u` and b = x / a. Pairs with a = 0 get
    none. association: (U, K, N) in [0, 1]; efficiency: (U, K, N) bit/s/Hz. Raises SubproblemError.
    """
    n_uavs, n_users, n_slots = efficiency.shape
    flat = (n_uavs, n_users * n_slots)
    allowed = (association > RESIDUE).reshape(flat).astype(float)
    share = cp.Variable(flat, bounds=[np.zeros(flat), allowed])
    rate_kbps = (problem.bandwidth_hz[:, None, None] * efficiency / 1e3).reshape(flat)
    rates = cp.reshape(cp.sum(cp.multiply(share, rate_kbps), axis=0), (n_users, n_slots), order="C")  # eq. (3)
    constraints = [
        cp.sum(cp.reshape(share[u], (n_users, n_slots), order="C"), axis=0) <= 1  # (6c)
        for u in range(n_uavs)
    ]
    maximise_with_least_rates(problem, rates, least_rates(problem), constraints)
    x = whole_shares(share.value.reshape(efficiency.shape), allowed.reshape(efficiency.shape))
    bandwidth: Array = problem.bandwidth_hz[:, None, None] * x / np.where(association > RESIDUE, association, 1.0)
    return bandwidth


def whole_shares(share: Array, allowed: Array) -> Array:
    """Shares (U, K, N) without the interior point method's residue, and filling each band that is used at all.

    Every utility grows with every rate, so what the residue held goes to the users that remain.
    """
    clean = np.where((share > RESIDUE) & (allowed > 0), share, 0.0)
    used = clean.sum(axis=1, keepdims=True)
    filled: Array = clean / np.where(used > 0, used, 1.0)
    return filled
