"""Problem (a5): bandwidth for a given (relaxed or binary) association."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem
from planner.reference.objective import concave_utility, solve

Array = NDArray[np.float64]


def best_bandwidth(problem: Problem, association: Array, efficiency: Array) -> Array:
    """Solve (a5): B >= 0 for given A and Q, under (6c); (U, K, N) Hz.

    What decides is the product x = a b, so the variable is x in shares of `B_u` and b = x / a. Pairs with a = 0 get
    none. association: (U, K, N) in [0, 1]; efficiency: (U, K, N) bit/s/Hz.
    """
    n_uavs, n_users, n_slots = efficiency.shape
    flat = (n_uavs, n_users * n_slots)
    share = cp.Variable(flat, nonneg=True)
    allowed = (association > 1e-9).reshape(flat).astype(float)
    rate_kbps = (problem.bandwidth_hz[:, None, None] * efficiency / 1e3).reshape(flat) * allowed
    rates = cp.reshape(cp.sum(cp.multiply(share, rate_kbps), axis=0), (n_users, n_slots), order="C")  # eq. (3)
    constraints = [
        cp.sum(cp.reshape(cp.multiply(share[u], allowed[u]), (n_users, n_slots), order="C"), axis=0) <= 1  # (6c)
        for u in range(n_uavs)
    ]
    constraints.append(cp.multiply(share, 1 - allowed) == 0)
    solve(concave_utility(problem, rates), constraints)
    x = np.clip(share.value, 0.0, None).reshape(efficiency.shape) * allowed.reshape(efficiency.shape)
    x /= np.maximum(x.sum(axis=1, keepdims=True), 1.0)
    bandwidth: Array = problem.bandwidth_hz[:, None, None] * x / np.where(association > 1e-9, association, 1.0)
    return bandwidth
