"""Problem (a4): the relaxed UAV-user association, and the mapping back to a binary one."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.reference.objective import least_rates, maximise_with_least_rates


def relaxed_association(problem: Problem, bandwidth_hz: Array, efficiency: Array) -> Array:
    """Solve (a4): A~ in [0, 1] for given B and Q; (U, K, N).

    bandwidth_hz: (U, K, N) Hz; efficiency: (U, K, N) bit/s/Hz at the given trajectories. A UAV that has left serves
    no user. Raises SubproblemError.
    """
    n_uavs, n_users, n_slots = efficiency.shape
    flat = (n_uavs, n_users * n_slots)
    flying = np.broadcast_to(problem.flying[:, None, :], efficiency.shape).reshape(flat).astype(float)
    a = cp.Variable(flat, bounds=[np.zeros(flat), flying])  # (11b)
    rate_kbps = (bandwidth_hz * efficiency / 1e3).reshape(flat)  # r_uk[n] of eq. (4)
    rates = cp.reshape(cp.sum(cp.multiply(a, rate_kbps), axis=0), (n_users, n_slots), order="C")  # eq. (3)
    share = (bandwidth_hz / problem.bandwidth_hz[:, None, None]).reshape(flat)
    constraints = [cp.sum(a, axis=0) == 1]  # (11a)
    for u in range(n_uavs):
        used = cp.reshape(cp.multiply(a[u], share[u]), (n_users, n_slots), order="C")
        constraints.append(cp.sum(used, axis=0) <= 1)  # (11c), in shares of B_u
    maximise_with_least_rates(problem, rates, least_rates(problem), constraints)
    relaxed: Array = np.clip(a.value.reshape(efficiency.shape), 0.0, 1.0) * problem.flying[:, None, :]
    return relaxed


def nearest_binary(problem: Problem, relaxed: Array, bandwidth_hz: Array, efficiency: Array) -> NDArray[np.intp]:
    """Assign each user to the UAV that gives it most under the relaxed A~ and B (Algorithm 1, line 9).

    A user that gets nothing goes to its best channel. Returns (K, N) UAV indices, so that (6a) and (6b) hold by
    construction; a UAV that has left serves no user.
    """
    given = relaxed * bandwidth_hz * efficiency
    idle = given.max(axis=0) <= 1e-6 * float(problem.bandwidth_hz.max())
    preference = np.where(idle, efficiency, given)
    serving: NDArray[np.intp] = np.argmax(np.where(problem.flying[:, None, :], preference, -1.0), axis=0)
    return serving
