"""Problem (a4): the relaxed UAV-user association, and the mapping back to a binary one."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem
from planner.reference.objective import concave_utility, solve

Array = NDArray[np.float64]


def relaxed_association(problem: Problem, bandwidth_hz: Array, efficiency: Array) -> Array:
    """Solve (a4): A~ in [0, 1] for given B and Q; (U, K, N).

    bandwidth_hz: (U, K, N) Hz; efficiency: (U, K, N) bit/s/Hz at the given trajectories.
    """
    n_uavs, n_users, n_slots = efficiency.shape
    flat = (n_uavs, n_users * n_slots)
    a = cp.Variable(flat, bounds=[0, 1])
    rate_kbps = (bandwidth_hz * efficiency / 1e3).reshape(flat)  # r_uk[n] of eq. (4)
    rates = cp.reshape(cp.sum(cp.multiply(a, rate_kbps), axis=0), (n_users, n_slots), order="C")  # eq. (3)
    share = (bandwidth_hz / problem.bandwidth_hz[:, None, None]).reshape(flat)
    constraints = [cp.sum(a, axis=0) == 1]  # (11a)
    for u in range(n_uavs):
        used = cp.reshape(cp.multiply(a[u], share[u]), (n_users, n_slots), order="C")
        constraints.append(cp.sum(used, axis=0) <= 1)  # (11c), in shares of B_u
    solve(concave_utility(problem, rates), constraints)
    relaxed: Array = np.clip(a.value.reshape(efficiency.shape), 0.0, 1.0)
    return relaxed


def nearest_binary(relaxed: Array, efficiency: Array) -> NDArray[np.intp]:
    """Algorithm 1, line 9: each user to the UAV with the largest relaxed share; ties to the better channel.

    Returns (K, N) UAV indices, so that (6a) and (6b) hold by construction.
    """
    tie_break = 1e-6 * efficiency / max(float(efficiency.max()), 1e-300)
    serving: NDArray[np.intp] = np.argmax(np.round(relaxed, 4) + tie_break, axis=0)
    return serving
