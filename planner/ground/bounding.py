"""What no plan over this ground can exceed: every link as near, and every interferer as far, as heights allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import bound_of_pairs_kbps
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range
from skyfolio.planner.sinr import mean_efficiency


def bound_over_kbps(problem: Problem, ground: Ground) -> float:
    """Return an upper bound of the utility of every feasible plan over the ground, in kbit/s.

    Without limits a UAV flies as low as it may, which is never higher than above the highest ground of all.
    """
    near2, far2 = squared_distance_range(replace(problem, altitude_m=np.zeros(problem.n_uavs)))
    lowest, highest = _span(problem, ground)
    over = ground.user_ground_m[None]
    low, high = lowest[:, None, None] - over, highest[:, None, None] - over
    nearest2 = _nearest2(problem, ground)
    away2 = near2, far2
    near2 = np.maximum(near2 + np.maximum(low, 0.0) ** 2, nearest2[None])
    far2 = np.maximum(far2 + np.maximum(low**2, high**2), near2)
    snr = problem.snr_gain / near2, problem.snr_gain / far2
    if problem.bends is not None or ground.has_hills:
        most, least = ground.channel.gain_bounds(*away2, near2, far2, low, high, hills=ground.has_hills)
        snr = problem.snr_gain * most, problem.snr_gain * least
    pairs = mean_efficiency(*snr, problem.draws)
    return bound_of_pairs_kbps(problem, pairs * (problem.bandwidth_hz / 1e3)[:, None, None])


def _span(problem: Problem, ground: Ground) -> tuple[Array, Array]:
    """Return the least and the greatest altitude of each UAV, wherever it is: (U,) each."""
    corners = np.vstack([problem.low_m, problem.high_m, ground.home_m])
    cells = ground.terrain.heights_around(corners.min(axis=0), corners.max(axis=0))
    above = np.where(np.isfinite(ground.high_m), ground.high_m, ground.low_m)
    start = np.where(np.isfinite(ground.start_m), ground.start_m, -np.inf)
    return cells.min() + ground.low_m, np.maximum(cells.max() + above, start) + 1.0


def _nearest2(problem: Problem, ground: Ground) -> Array:
    """Return how near any UAV can come to each user at all, over the cells of the grid: (K, N or 1) m^2."""
    west_south, east_north, ground_m = ground.terrain.cells_in(problem.low_m, problem.high_m)
    least: Array = ground_m + ground.low_m.min()
    nearest: Array = np.zeros(ground.user_ground_m.shape)
    for k in range(len(nearest)):
        for s, over_m in enumerate(ground.user_ground_m[k].tolist()):
            east, north = problem.user_m[k, s].tolist()
            at = np.array([east, north])
            away = np.maximum(np.maximum(west_south - at, at - east_north), 0.0)
            up = np.maximum(least - over_m, 0.0)
            nearest[k, s] = (np.square(away).sum(axis=1) + up**2).min()
    return np.maximum(nearest, 1e-6)
