"""How close aircraft come: at the slots and on the straight legs between them."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import nearest_to_origin


def closest_approach(paths_m: Array) -> float:
    """Return the least distance between any two UAVs that fly straight from slot to slot, in metres.

    paths_m: (U, N, 2), metres east/north. Infinite for one UAV. Within a slot both fly at constant velocity, so their
    relative position moves along a segment, whose distance to 0 has a closed form.
    """
    least = np.inf
    for u in range(len(paths_m) - 1):
        apart = paths_m[u + 1 :] - paths_m[u]  # (others, N, 2)
        least = min(least, float(np.sqrt(_least_squared(apart))))
    return least


def _least_squared(apart: Array) -> float:
    """Return the least squared distance to 0 of the polylines `apart`: (pairs, N, 2)."""
    least = float((apart**2).sum(axis=-1).min())
    if apart.shape[1] < 2:
        return least
    nearest = nearest_to_origin(apart[:, :-1], np.diff(apart, axis=1))
    return min(least, float((nearest**2).sum(axis=-1).min()))
