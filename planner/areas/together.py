"""Whether areas that were planned at the same time can fly together: D_min across their borders."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.areas.partition import Ints
from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import nearest_to_origin
from skyfolio.planner.problem import Problem


def clashing(problem: Problem, before_m: Array, after_m: Array, owners: list[Ints]) -> set[int]:
    """Return which of these areas, by number, must keep their old paths, so that nobody comes closer than D_min.

    before_m, after_m: (U, N, 2), feasible paths and those with the areas' new ones. owners: the UAVs of each.
    """
    area_of = np.full(problem.n_uavs, -1)
    for number, own in enumerate(owners):
        area_of[own] = number
    paths_m, refused = after_m.copy(), set()
    asked = [int(uav) for own in owners for uav in own]
    while asked:
        uav = asked.pop()
        for other in _too_close(problem, paths_m, uav):
            for one in (area_of[uav], area_of[other]):
                if one >= 0 and one not in refused:
                    refused.add(int(one))
                    own = owners[one]
                    paths_m[own] = before_m[own]
                    asked += own.tolist()  # others may have moved into the way of the old paths
                    break
    return refused


def _too_close(problem: Problem, paths_m: Array, uav: int) -> Ints:
    """Return the UAVs that come closer than D_min to this one while both fly."""
    flying = np.minimum(problem.n_flying, problem.n_flying[uav])
    apart = paths_m - paths_m[uav]
    legs = nearest_to_origin(apart[:, :-1], np.diff(apart, axis=1)) if apart.shape[1] > 1 else apart
    slot = np.arange(legs.shape[1])
    least2 = np.where(slot < flying[:, None] - 1, (legs**2).sum(axis=-1), np.inf).min(axis=1)
    last = np.minimum(flying, apart.shape[1]) - 1
    at_last = apart[np.arange(len(apart)), last]
    least2 = np.minimum(least2, (at_last**2).sum(axis=-1))
    least2[uav] = np.inf
    return np.flatnonzero(least2 < problem.separation_m**2)
