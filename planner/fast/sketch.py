"""Which users to hover over, quickly: UAVs change users while the sum of spectral efficiencies grows.

Everybody's interference is kept in sums, so that a move costs U steps, and most moves none: what a user could give at
most, with nobody disturbed by it, is known from one sum. What flying there costs is taken off.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Ints, entry, smooth
from skyfolio.planner.fast.rates import PER_LN

SWEEPS = 20
LEAST_GAIN = 1e-6


@entry
def exchange_users(
    sites_m: Array, user_m: Array, gain: Array, height2: Array, khz: Array, cost: Array, chosen: Ints
) -> float:
    """Improve `chosen` (U,), distinct users, in place until no move helps; kbit/s less `cost` that it comes to.

    sites_m: (2, K), where a UAV hovers that serves each user; user_m: (2, K). gain: (U, 1 or K), m^2; khz: (U,);
    cost: (U, K), kbit/s.
    """
    n_uavs, n_users = cost.shape
    taken = np.zeros(n_users, dtype=np.int64)
    for u in range(n_uavs):
        taken[chosen[u]] = 1
    quiet, own, others = np.empty(n_users), np.empty(n_uavs), np.empty(n_uavs)
    for _ in range(SWEEPS):
        gained = 0.0
        for u in range(n_uavs):
            _interference(sites_m, user_m, gain, height2, chosen, u, quiet)
            to, gain_u = _best_user(sites_m, user_m, gain, height2, khz, cost, chosen, taken, u, quiet, own, others)
            if to != chosen[u]:
                taken[chosen[u]], taken[to] = 0, 1
                chosen[u] = to
                gained += gain_u
        if gained <= LEAST_GAIN:
            break
    total = 0.0
    for u in range(n_uavs):
        _interference(sites_m, user_m, gain, height2, chosen, u, quiet)
        k = chosen[u]
        total += khz[u] * PER_LN * np.log(1.0 + _own(sites_m, user_m, gain, height2, u, k) / quiet[k]) - cost[u, k]
    return float(total)


@smooth
def _own(sites_m: Array, user_m: Array, gain: Array, height2: Array, u: int, k: int) -> float:
    de, dn = sites_m[0, k] - user_m[0, k], sites_m[1, k] - user_m[1, k]
    return float(gain[u, k if gain.shape[1] > 1 else 0] / (de * de + dn * dn + height2[u]))


@smooth
def _interference(
    sites_m: Array, user_m: Array, gain: Array, height2: Array, chosen: Ints, u: int, quiet: Array
) -> None:
    """1 + what every user hears of all UAVs but u, into `quiet` (K,)."""
    east, north, shared = user_m[0], user_m[1], gain.shape[1] == 1
    for k in range(quiet.shape[0]):
        quiet[k] = 1.0
    for v in range(chosen.shape[0]):
        if v == u:
            continue
        x, y, h2, row = sites_m[0, chosen[v]], sites_m[1, chosen[v]], height2[v], gain[v]
        for k in range(quiet.shape[0]):
            de, dn = x - east[k], y - north[k]
            quiet[k] += (row[0] if shared else row[k]) / (de * de + dn * dn + h2)


@smooth
def _best_user(
    sites_m: Array,
    user_m: Array,
    gain: Array,
    height2: Array,
    khz: Array,
    cost: Array,
    chosen: Ints,
    taken: Ints,
    u: int,
    quiet: Array,
    own: Array,
    others: Array,
) -> tuple[int, float]:
    """The user that UAV u should hover over, everybody else staying, and by how much that is better than now."""
    top, n_uavs = 0.0, chosen.shape[0]
    for v in range(n_uavs):
        if v != u:
            own[v] = _own(sites_m, user_m, gain, height2, v, chosen[v])
            others[v] = max(quiet[chosen[v]] - own[v], 1.0)
            top += khz[v] * PER_LN * np.log(1.0 + own[v] / others[v])
    best, now, to = -np.inf, -np.inf, chosen[u]
    for i in range(-1, quiet.shape[0]):
        k = chosen[u] if i < 0 else i
        if i >= 0 and taken[k] != 0:
            continue
        value = khz[u] * PER_LN * np.log(1.0 + _own(sites_m, user_m, gain, height2, u, k) / quiet[k]) - cost[u, k]
        if top + value <= best + LEAST_GAIN:
            continue
        x, y = sites_m[0, k], sites_m[1, k]
        for v in range(n_uavs):
            if v != u:
                j = chosen[v]
                de, dn = x - user_m[0, j], y - user_m[1, j]
                heard = gain[u, j if gain.shape[1] > 1 else 0] / (de * de + dn * dn + height2[u])
                value += khz[v] * PER_LN * np.log(1.0 + own[v] / (others[v] + heard))
        if i < 0:
            now = value
        if value > best + LEAST_GAIN:
            best, to = value, k
    return int(to), float(best - now)
