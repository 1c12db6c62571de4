"""Association and bandwidth where several users share a UAV: `per_user`, `pooled`, and minimum rates under `sum`.

(1/mu) log(.) is convex for mu < 0, so its tangent is a minorant, exact at the last iterate: maximising the minorant
means minimising sum_k w_k exp(mu R_k[n]) with w_k = 1 / sum_n exp(mu R_k[n]), slot by slot, and never lowers the
utility. Within a UAV that is water-filling, b_k = max(0, log(w_k a_k / lambda)) / a_k with a_k = |mu| s_k, in closed
form. Between UAVs, users move one at a time to where the prices lambda promise more, and only stay when the slot
really is better: the association is binary at every step, so nothing is lost by rounding.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Ints, Links, hide_absent, kernel, smooth
from skyfolio.planner.fast.elementary import PER_LN2, log
from skyfolio.planner.fast.enumerating import FEW_WAYS, try_all
from skyfolio.planner.fast.exchange import THOROUGH, exchange, share_slot
from skyfolio.planner.fast.market import Market, enter_slot, market_of
from skyfolio.planner.fast.rates import keep_pins, slot_signals, user_sums


@kernel
def share_all(arena: Arena, path: Array, links: Links, thorough: bool) -> None:
    """Minimise the minorant of `links.log_weight` at `path` (N, 2, U): new UAVs and kHz in `links`; entry k is user k.

    Slots without links are filled from scratch. thorough: try also what the prices speak against, for few users.
    """
    n_uavs, n_users = path.shape[2], arena.user_m.shape[2]
    signal, total, best = np.empty((n_uavs, n_users)), np.empty(n_users), np.empty(n_users)
    market = market_of(arena, links.log_weight)
    eff = market.eff
    for n in range(path.shape[0]):
        slot_signals(arena, path[n], n, signal, total)
        if arena.has_pinned_to:
            keep_pins(arena, n, signal)
        if arena.has_absent:
            hide_absent(arena, n, signal)
        enter_slot(arena, market, n)
        fresh = links.used[n] == 0
        if fresh and n > 0:
            links.uav[n] = links.uav[n - 1]
        candidates(signal, total, links.uav[n], fresh and n == 0, best, eff)
        share_slot(market, links.uav[n], links.khz[n])
        if thorough and n_users <= THOROUGH:
            exchange(market, links.uav[n], links.khz[n])
        if thorough and arena.has_demand and float(n_uavs) ** n_users <= FEW_WAYS:
            try_all(market, links.uav[n], links.khz[n])
        for k in range(n_users if arena.has_floors else 0):
            links.floor[n, k] = _floor(arena, market, k, links.khz[n, k] * eff[k, links.uav[n, k]])
        if fresh:
            links.used[n] = n_users
            for k in range(n_users):
                links.user[n, k] = k


@kernel
def _floor(arena: Arena, market: Market, k: int, rate: float) -> float:
    """Return what user k, who gets `rate` kbit/s, keeps while UAVs move."""
    if arena.has_demand and rate >= arena.demand[k] * (1.0 - 1e-12):
        return float(arena.demand[k])
    return float(market.least[k]) if rate >= market.least[k] * (1.0 - 1e-12) else 0.0


@kernel
def tangent_weights(arena: Arena, links: Links, rate: Array, log_weight: Array, part: Array) -> None:
    """Log w of the minorant that is exact at `rate` (N, W), into `log_weight` (K,), the greatest shifted to 0.

    part: (N, W), scratch.
    """
    z, count, top = np.empty(log_weight.shape[0]), np.empty(log_weight.shape[0]), -np.inf
    user_sums(arena, links, rate, np.bool_(False), log_weight, z, count, part)
    for k in range(z.shape[0]):
        if count[k] > 0.0:
            log_weight[k] = np.log(count[k] / z[k]) - arena.mu * log_weight[k]
        log_weight[k] += np.log(arena.weight[k])
        top = max(top, log_weight[k])
    for k in range(z.shape[0]):
        log_weight[k] -= top


@kernel
def candidates(signal: Array, total: Array, serving: Ints, fresh: bool, best: Array, eff: Array) -> None:
    """log2(1 + SINR) of all pairs into `eff` (K, U), 0 for UAVs that have left; `fresh` users get their best UAV.

    signal: (U, K) SNR; total: (K,), 1 + their sum; serving: (K,); best: (K,), scratch.
    """
    n_uavs, n_users = signal.shape
    for u in range(n_uavs):
        _efficiencies(signal[u], total, best)
        for k in range(n_users):
            eff[k, u] = best[k]
    for k in range(n_users):
        if fresh or signal[serving[k], k] <= 0.0:
            for u in range(n_uavs):
                if signal[u, k] > signal[serving[k], k]:
                    serving[k] = u


@smooth
def _efficiencies(signal: Array, total: Array, efficiency: Array) -> None:
    for k in range(signal.shape[0]):
        others = max(total[k] - signal[k], 1.0)
        efficiency[k] = PER_LN2 * log((others + signal[k]) / others)


@kernel
def new_links(links: Links) -> Links:
    """Tables of the same size, not filled."""
    shape = links.khz.shape
    return Links(
        np.empty(shape[0], dtype=np.int64),
        np.empty(shape, dtype=np.int64),
        np.empty(shape, dtype=np.int64),
        np.empty(shape),
        np.empty(shape),
        np.empty(links.log_weight.shape[0]),
    )


@kernel
def copy_links(source: Links, target: Links) -> None:
    """Copy all tables."""
    for n in range(source.khz.shape[0]):
        target.used[n] = source.used[n]
        for j in range(source.khz.shape[1]):
            target.user[n, j], target.uav[n, j] = source.user[n, j], source.uav[n, j]
            target.khz[n, j], target.floor[n, j] = source.khz[n, j], source.floor[n, j]
    for k in range(source.log_weight.shape[0]):
        target.log_weight[k] = source.log_weight[k]
