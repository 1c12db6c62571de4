"""Association and bandwidth where several users share a UAV: `per_user`, `pooled`, and least rates under `sum`.

(1/mu) log(.) is convex for mu < 0, so its tangent is a minorant, exact at the last iterate: maximising the minorant
means minimising sum_k w_k exp(mu R_k[n]) with w_k = 1 / sum_n exp(mu R_k[n]), slot by slot, and never lowers the
utility. Within a UAV that is water-filling, b_k = max(0, log(w_k a_k / lambda)) / a_k with a_k = |mu| s_k, in closed
form. Between UAVs, users move one at a time to where the prices lambda promise more, and only stay when the slot
really is better: the association is binary at every step, so nothing is lost by rounding.
"""

from __future__ import annotations

import numpy as np

from planner.fast.arena import SUM, Arena, Array, Ints, Links, kernel
from planner.fast.rates import PER_LN, link_rates, slot_signals, user_sums

CANDIDATES = 4
"""A user may move to the UAVs that it hears best, this many."""
SWEEPS = 4
UNMET = 1e9
"""What leaving one least rate unmet costs, beside which every utility is small."""


@kernel
def share_all(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """One minorise-maximise step at `path` (N, 2, U): new users, UAVs and kHz in `links`; entry k is user k.

    rate: (N, W), scratch. Slots without links are filled from scratch.
    """
    n_uavs, n_users = path.shape[2], arena.user_m.shape[1]
    signal, total, eff = np.empty((n_uavs, n_users)), np.empty(n_users), np.zeros((n_uavs, n_users))
    log_weight = np.zeros(n_users)
    if arena.kind != SUM:
        link_rates(arena, path, links, rate)
        _log_weights(arena, links, rate, log_weight)
    for n in range(path.shape[0]):
        slot_signals(arena, path[n], n, signal, total)
        fresh = links.used[n] == 0
        candidates(signal, total, links.uav[n], fresh, eff)
        share_slot(arena, eff, log_weight, links.uav[n], links.khz[n])
        for k in range(n_users if arena.has_minimum else 0):
            met = links.khz[n, k] * eff[links.uav[n, k], k] >= arena.min_kbps[k] * (1.0 - 1e-12)
            links.floor[n, k] = arena.min_kbps[k] if met else 0.0
        if fresh:
            links.used[n] = n_users
            for k in range(n_users):
                links.user[n, k] = k


@kernel
def _log_weights(arena: Arena, links: Links, rate: Array, log_weight: Array) -> None:
    """log w of the minorant at `rate` into `log_weight` (K,), the greatest shifted to 0."""
    z, count, top = np.empty(log_weight.shape[0]), np.empty(log_weight.shape[0]), -np.inf
    user_sums(arena, links, rate, np.bool_(False), log_weight, z, count)
    for k in range(z.shape[0]):
        log_weight[k] = np.log(count[k] / z[k]) - arena.mu * log_weight[k]
        top = max(top, log_weight[k])
    for k in range(z.shape[0]):
        log_weight[k] -= top


@kernel
def candidates(signal: Array, total: Array, serving: Ints, fresh: bool, eff: Array) -> None:
    """log2(1 + SINR) of the pairs that may be linked into `eff` (U, K), 0 elsewhere; `fresh` users get their best UAV.

    signal: (U, K) SNR; total: (K,), 1 + their sum; serving: (K,).
    """
    n_uavs, n_users = signal.shape
    for k in range(n_users):
        for u in range(n_uavs):
            eff[u, k] = 0.0
        most = np.inf
        for rank in range(min(CANDIDATES, n_uavs)):
            best, u = 0.0, -1
            for i in range(n_uavs):
                if best < signal[i, k] < most:
                    best, u = signal[i, k], i
            if u < 0:
                break
            most = best
            eff[u, k] = _efficiency(best, total[k])
            if rank == 0 and (fresh or signal[serving[k], k] <= 0.0):
                serving[k] = u
        u = serving[k]
        eff[u, k] = _efficiency(signal[u, k], total[k])


@kernel
def _efficiency(signal: float, total: float) -> float:
    others = max(total - signal, 1.0)
    return float(PER_LN * np.log((others + signal) / others))


@kernel
def share_slot(arena: Arena, eff: Array, log_weight: Array, serving: Ints, khz: Array) -> None:
    """Improve `serving` (K,) of a slot, and fill `khz` (K,): moves of single users until none helps."""
    n_uavs, n_users = eff.shape
    cost, price = np.zeros(n_uavs), np.zeros(n_uavs)
    members, was = np.empty(n_users, dtype=np.int64), np.empty(n_users)
    for u in range(n_uavs):
        cost[u], price[u] = fill(arena, u, eff[u], log_weight, serving, khz, members)
    for _ in range(SWEEPS):
        moved = False
        for k in range(n_users):
            u = _promising(arena, k, eff, log_weight, price, serving[k], khz[k])
            if u >= 0 and _try_move(arena, k, u, eff, log_weight, serving, khz, cost, price, members, was):
                moved = True
        if not moved:
            return


@kernel
def _promising(arena: Arena, k: int, eff: Array, log_weight: Array, price: Array, u: int, khz: float) -> int:
    """The UAV that promises user k more than u, which gives it `khz`, at the present prices, or -1."""
    best, least = (-1), np.inf
    if khz * eff[u, k] >= arena.min_kbps[k] * (1.0 - 1e-12):
        least = _lagrangian(arena, k, eff[u, k], log_weight[k], price[u], arena.khz[u]) - 1e-12
    for i in range(eff.shape[0]):
        if i != u and eff[i, k] > 0.0:
            promised = _lagrangian(arena, k, eff[i, k], log_weight[k], price[i], arena.khz[i])
            if promised < least:
                least, best = promised, i
    return best


@kernel
def _try_move(
    arena: Arena,
    k: int,
    to: int,
    eff: Array,
    log_weight: Array,
    serving: Ints,
    khz: Array,
    cost: Array,
    price: Array,
    members: Ints,
    was: Array,
) -> bool:
    """Move user k to UAV `to` when both slots together really cost less for it; whether it moved."""
    u = serving[k]
    for other in range(khz.shape[0]):
        was[other] = khz[other]
    serving[k] = to
    cost_u, price_u = fill(arena, u, eff[u], log_weight, serving, khz, members)
    cost_to, price_to = fill(arena, to, eff[to], log_weight, serving, khz, members)
    before = cost[u] + cost[to]
    if cost_u + cost_to < before - 1e-12 * abs(before):
        cost[u], price[u], cost[to], price[to] = cost_u, price_u, cost_to, price_to
        return True
    serving[k] = u
    for other in range(khz.shape[0]):
        khz[other] = was[other]
    return False


@kernel
def _lagrangian(arena: Arena, k: int, eff: float, log_weight: float, price: float, widest: float) -> float:
    """What user k costs at a UAV where a kHz has this (log, for `sum` plain) price, when it takes what suits it."""
    if eff <= 0.0:
        return np.inf
    least_khz = arena.min_kbps[k] / eff
    if arena.kind == SUM:
        return float(least_khz * price - arena.min_kbps[k] - max(0.0, eff - price) * widest)
    a = -arena.mu * eff
    if price == -np.inf:  # nobody is there: all of it
        return float(np.exp(log_weight - a * widest))
    wanted = max((log_weight + np.log(a) - price) / a, least_khz)
    if wanted <= 0.0:
        return float(np.exp(log_weight))
    return float(np.exp(log_weight - a * wanted) + np.exp(price) * wanted)


@kernel
def fill(
    arena: Arena, u: int, eff: Array, log_weight: Array, serving: Ints, khz: Array, members: Ints
) -> tuple[float, float]:
    """Share the band of UAV u among its users, least rates first, into `khz` (K,): (cost of the slot, price of a kHz).

    eff, log_weight: (K,). members: (K,), scratch. The price is a logarithm unless the utility is `sum`.
    """
    count, left = 0, arena.khz[u]
    for k in range(serving.shape[0]):
        if serving[k] == u:
            members[count] = k
            khz[k] = 0.0
            count += 1
    if count == 0:
        return 0.0, (0.0 if arena.kind == SUM else -np.inf)
    cost = 0.0
    if arena.has_minimum:
        left, cost = _reserve(arena.min_kbps, eff, left, members[:count], khz)
    if arena.kind == SUM:
        top = members[0]
        for i in range(count):
            if eff[members[i]] > eff[top]:
                top = members[i]
        khz[top] += left
        for i in range(count):
            cost -= khz[members[i]] * eff[members[i]]
        return cost, eff[top]
    price = water_fill(-arena.mu, eff, log_weight, left, members[:count], khz)
    for i in range(count):
        k = members[i]
        cost += np.exp(log_weight[k] + arena.mu * eff[k] * khz[k])
    return cost, price


@kernel
def _reserve(min_kbps: Array, eff: Array, left: float, members: Ints, khz: Array) -> tuple[float, float]:
    """Give each member what its least rate takes, the cheapest first while it lasts: (kHz left, penalty)."""
    cost = 0.0
    waiting = 0
    for k in members:
        waiting += min_kbps[k] > 0.0
    while waiting > 0:
        cheapest, least = -1, np.inf
        for k in members:
            if min_kbps[k] > 0.0 and khz[k] == 0.0 and eff[k] > 0.0 and min_kbps[k] / eff[k] < least:
                cheapest, least = k, min_kbps[k] / eff[k]
        if cheapest < 0 or least > left:
            return left, UNMET * waiting
        khz[cheapest] = least
        left -= least
        waiting -= 1
    return left, cost


@kernel
def water_fill(decay: float, eff: Array, log_weight: Array, left: float, members: Ints, khz: Array) -> float:
    """Add `left` kHz to what `khz` (K,) gives the members, minimising sum w exp(-decay eff khz); the log of lambda.

    Members whose first kHz is worth less than lambda drop out until none does: finite and exact, as in projecting on
    a simplex.
    """
    active = members.shape[0]
    level = -np.inf
    while True:
        worth, width, kept = 0.0, 0.0, 0
        for i in range(active):
            k = members[i]
            a = decay * eff[k]
            if a <= 0.0:
                continue
            first = log_weight[k] + np.log(a) - a * khz[k]
            if first > level:
                worth += first / a
                width += 1.0 / a
                members[i], members[kept] = members[kept], k
                kept += 1
        if kept == 0:
            return level
        settled = kept == active and level > -np.inf
        level, active = (worth - left) / width, kept
        if settled:
            break
    for i in range(active):
        k = members[i]
        a = decay * eff[k]
        khz[k] += max(0.0, (log_weight[k] + np.log(a) - level) / a - khz[k])
    return level
