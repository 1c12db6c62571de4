"""What arrives at users from UAVs outside an area: noise that differs from user to user and from slot to slot."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import entry, plain, smooth


def heard(gain: Array, paths_m: Array, altitude_m: Array, user_m: Array) -> Array:
    """Return 1 + the sum of the SNRs of all these UAVs at each user in each slot: (K, N).

    gain: (V, N), m^2, alike for all users; paths_m: (V, N, 2) and user_m: (K, 2), metres; altitude_m: (V,).
    """
    total = np.ones((gain.shape[1], len(user_m)))
    _hear(plain(gain), plain(paths_m), plain(altitude_m**2), plain(user_m.T), total)
    return np.ascontiguousarray(total.T)


@entry
def _hear(gain: Array, paths_m: Array, height2: Array, user_m: Array, total: Array) -> None:
    """total: (N, K), added to."""
    for v in range(gain.shape[0]):
        for n in range(gain.shape[1]):
            _add(gain[v, n], paths_m[v, n, 0], paths_m[v, n, 1], height2[v], user_m[0], user_m[1], total[n])


@smooth
def _add(gain: float, x: float, y: float, height2: float, east: Array, north: Array, row: Array) -> None:
    for k in range(row.shape[0]):
        de, dn = x - east[k], y - north[k]
        row[k] += gain / (de * de + dn * dn + height2)
