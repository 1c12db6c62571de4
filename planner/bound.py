"""The certificate: a rate no feasible plan can exceed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from planner.problem import Problem
from planner.utility import soft_mean

Array = NDArray[np.float64]


def reachability_bound_kbps(problem: Problem) -> float:
    """An upper bound of the utility of every feasible plan, in kbit/s.

    In slot n a UAV is within `n D_max` of its start and in the area. Each pair gets the nearest own and the farthest
    interfering distance that this allows; the best distinct pairing then bounds the sum rate of the slot (under (6a)
    and (6c) a UAV's whole band to its best user is the most a slot can give). `sum` increases in every slot's sum
    rate; the other utilities are at most the mean sum rate by Jensen's inequality.
    """
    per_slot = slot_bounds_kbps(problem)
    past = problem.past_kbps.sum(axis=0)
    return soft_mean(np.concatenate([past, per_slot]), problem.mu if problem.kind == "sum" else 0.0)


def slot_bounds_kbps(problem: Problem) -> Array:
    """Upper bound of the sum rate of each slot: (N,) kbit/s."""
    near2, far2 = _distance_range2(problem)
    strongest = problem.snr_gain / near2
    weakest = problem.snr_gain / far2
    efficiency = np.empty_like(strongest)
    for u in range(problem.n_uavs):
        efficiency[u] = np.log1p(strongest[u] / (1.0 + np.delete(weakest, u, axis=0).sum(axis=0))) / np.log(2)
    rates = problem.bandwidth_hz[:, None, None] * efficiency / 1e3
    bounds = np.empty(problem.n_slots)
    for n in range(problem.n_slots):
        chosen = linear_sum_assignment(rates[:, :, n], maximize=True)
        bounds[n] = rates[:, :, n][chosen].sum()
    return bounds


def _distance_range2(problem: Problem) -> tuple[Array, Array]:
    """Least and greatest squared distance of each (uav, user, slot) over the reachable set: two (U, K, N), m^2."""
    user = problem.user_m[None]
    start = np.linalg.norm(user - problem.start_m[:, None], axis=-1)  # (U, K)
    reach = problem.step_m[:, None] * np.arange(problem.n_slots)  # (U, N)
    to_area = np.linalg.norm(user[0] - np.clip(user[0], problem.low_m, problem.high_m), axis=-1)  # (K,)
    to_corner = np.linalg.norm(np.maximum(user[0] - problem.low_m, problem.high_m - user[0]), axis=-1)  # (K,)
    near = np.maximum(start[:, :, None] - reach[:, None, :], to_area[None, :, None])
    far = np.minimum(start[:, :, None] + reach[:, None, :], to_corner[None, :, None])
    height2 = problem.altitude_m[:, None, None] ** 2
    return near**2 + height2, far**2 + height2
