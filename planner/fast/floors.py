"""Minimum rates and met demands while the UAVs move: links keep their floors, the rest of each band is scaled.

Who has all that it asks for keeps just that: the better its channel becomes, the more band is left to the others.

With bands so tied to the positions, every iterate keeps the floors, and the utility stays smooth in the positions.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Links, kernel


@kernel
def free_bands(links: Links, rate: Array, free: Array) -> None:
    """Return what each link has above its floor, kHz, into `free` (N, W); rate: (N, W), what the links give."""
    for n in range(rate.shape[0]):
        for j in range(links.used[n]):
            free[n, j] = 0.0
            if rate[n, j] > 0.0:
                free[n, j] = max(0.0, links.khz[n, j] * (1.0 - links.floor[n, j] / rate[n, j]))


@kernel
def refit(arena: Arena, links: Links, free: Array, rate: Array, khz: Array) -> bool:
    """Bands `khz` (N, W) that keep the floors where those in `links` would give `rate` (N, W), which is brought up.

    What is above the floors, `free`, is scaled to the band that is left; False where the floors exceed a band.
    """
    n_uavs = arena.khz.shape[0]
    left, above = np.empty(n_uavs), np.empty(n_uavs)
    for n in range(rate.shape[0]):
        for u in range(n_uavs):
            left[u], above[u] = arena.khz[u], 0.0
        for j in range(links.used[n]):
            if rate[n, j] > 0.0:
                left[links.uav[n, j]] -= links.floor[n, j] * links.khz[n, j] / rate[n, j]
                above[links.uav[n, j]] += free[n, j]
        for u in range(n_uavs):
            if left[u] < 0.0:
                return False
            above[u] = left[u] / above[u] if above[u] > 0.0 else 0.0
        for j in range(links.used[n]):
            khz[n, j] = links.khz[n, j]
            if rate[n, j] > 0.0:
                efficiency = rate[n, j] / links.khz[n, j]
                khz[n, j] = links.floor[n, j] / efficiency + free[n, j] * above[links.uav[n, j]]
                rate[n, j] = khz[n, j] * efficiency
    return True


@kernel
def reweigh(arena: Arena, links: Links, free: Array, rate: Array, weight: Array) -> None:
    """From d utility / d rate at fixed bands to the same with the bands of `refit`: `weight` (N, W), in place.

    A better channel to a user with a floor leaves more band to all users of its UAV.
    """
    n_uavs = arena.khz.shape[0]
    gain, above = np.empty(n_uavs), np.empty(n_uavs)
    for n in range(rate.shape[0]):
        for u in range(n_uavs):
            gain[u] = above[u] = 0.0
        for j in range(links.used[n]):
            if rate[n, j] > 0.0:
                gain[links.uav[n, j]] += weight[n, j] * free[n, j] * rate[n, j] / links.khz[n, j]
                above[links.uav[n, j]] += free[n, j]
        for j in range(links.used[n]):
            u = links.uav[n, j]
            if rate[n, j] > 0.0 and above[u] > 0.0:
                kept = links.floor[n, j] / rate[n, j]
                worth_of_a_khz = gain[u] / above[u] * links.khz[n, j] / rate[n, j]
                weight[n, j] = weight[n, j] * (1.0 - kept) + worth_of_a_khz * kept
