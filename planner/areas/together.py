"""Whether an area's new paths keep D_min from all others, which fly as before."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.areas.partition import Ints
from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import nearest_to_origin
from skyfolio.planner.problem import Problem


def together(problem: Problem, paths_m: Array, changed: Ints) -> bool:
    """Return whether these UAVs keep D_min from all others while both fly, between slots too; paths_m: (U, N, 2)."""
    return all(_clear(problem, paths_m, int(uav)) for uav in changed)


def _clear(problem: Problem, paths_m: Array, uav: int) -> bool:
    flying = np.minimum(problem.n_flying, problem.n_flying[uav])
    flying[uav] = 0
    apart = paths_m - paths_m[uav]
    slot = np.arange(apart.shape[1])
    at_slots = (apart**2).sum(axis=-1)[slot < flying[:, None]]
    legs = nearest_to_origin(apart[:, :-1], np.diff(apart, axis=1))
    between = (legs**2).sum(axis=-1)[slot[:-1] < flying[:, None] - 1]
    least2 = min(at_slots.min(initial=np.inf), between.min(initial=np.inf))
    return bool(least2 >= problem.separation_m**2)
