"""One slot with demands, exactly, where there are few ways to give users to UAVs: all of them are tried.

Who serves whom so that all have what they ask for is a partition problem, which is hard; moves and exchanges
(`exchange.py`) find good ways, and among few users nothing but the best will do.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Ints, kernel
from skyfolio.planner.fast.market import Market, fill, join

FEW_WAYS = 1024
"""So many associations of one slot are tried at most."""


@kernel
def try_all(market: Market, serving: Ints, khz: Array) -> None:
    """Write the association `serving` (K,) of the least cost, and its bands `khz` (K,): given ones stay if they tie."""
    n_users, n_uavs = market.eff.shape
    best, best_serving, best_khz = 0.0, serving.copy(), khz.copy()
    for u in range(n_uavs):
        best += market.cost[u]
    trial = np.zeros(n_users, dtype=np.int64)
    for _ in range(n_uavs**n_users):
        cost = _cost(market, trial, khz)
        if cost < best - 1e-12 * abs(best):
            best = cost
            best_serving[:], best_khz[:] = trial, khz
        k = 0
        while k < n_users and trial[k] == n_uavs - 1:
            trial[k] = 0
            k += 1
        if k < n_users:
            trial[k] += 1
    serving[:], khz[:] = best_serving, best_khz


@kernel
def _cost(market: Market, serving: Ints, khz: Array) -> float:
    """Return what the slot costs with this association, and its bands in `khz` (K,)."""
    cost = 0.0
    for u in range(market.size.shape[0]):
        market.size[u] = 0
    for k in range(serving.shape[0]):
        join(market, k, serving[k])
        if market.eff[k, serving[k]] <= 0.0 < market.eff[k].max():
            return np.inf
    for u in range(market.size.shape[0]):
        fill(market, u, khz)
        cost += market.cost[u]
    return cost
