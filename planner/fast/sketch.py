"""Which users to hover over, quickly: UAVs change users while the sum of spectral efficiencies grows.

Everybody's interference is kept in sums, so that a move costs U steps, and most moves none: what a user could give at
most, with no other UAV disturbed by it, is known from one sum. What flying there costs is taken off.
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
    heard, row = np.ones(n_users), np.empty(n_users)
    quiet, own, others = np.empty(n_users), np.empty(n_uavs), np.empty(n_uavs)
    for u in range(n_uavs):
        taken[chosen[u]] = 1
        _hear(sites_m, user_m, gain, height2, u, chosen[u], row)
        heard += row
    for _ in range(SWEEPS):
        gained = 0.0
        for u in range(n_uavs):
            _hear(sites_m, user_m, gain, height2, u, chosen[u], row)
            for k in range(n_users):
                quiet[k] = max(heard[k] - row[k], 1.0)
            to, better = _best_user(sites_m, user_m, gain, height2, khz, cost, chosen, taken, u, quiet, own, others)
            if to != chosen[u]:
                taken[chosen[u]], taken[to] = 0, 1
                chosen[u] = to
                gained += better
                _hear(sites_m, user_m, gain, height2, u, to, row)
                for k in range(n_users):
                    heard[k] = quiet[k] + row[k]
        if gained <= LEAST_GAIN:
            break
    total = 0.0
    for u in range(n_uavs):
        k = chosen[u]
        signal = _own(sites_m, user_m, gain, height2, u, k)
        total += khz[u] * PER_LN * np.log(1.0 + signal / max(heard[k] - signal, 1.0)) - cost[u, k]
    return float(total)


@smooth
def _own(sites_m: Array, user_m: Array, gain: Array, height2: Array, u: int, k: int) -> float:
    de, dn = sites_m[0, k] - user_m[0, k], sites_m[1, k] - user_m[1, k]
    return float(gain[u, k if gain.shape[1] > 1 else 0] / (de * de + dn * dn + height2[u]))


@smooth
def _hear(sites_m: Array, user_m: Array, gain: Array, height2: Array, u: int, over: int, row: Array) -> None:
    """Return the SNR of UAV u over user `over` at every user, into `row` (K,)."""
    x, y, h2, shared = sites_m[0, over], sites_m[1, over], height2[u], gain.shape[1] == 1
    for k in range(row.shape[0]):
        de, dn = x - user_m[0, k], y - user_m[1, k]
        row[k] = (gain[u, 0] if shared else gain[u, k]) / (de * de + dn * dn + h2)


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
    """Return the user that UAV u should hover over, everybody else staying, and by how much that is better than now."""
    top, n_uavs, alone = 0.0, chosen.shape[0], np.empty(chosen.shape[0])
    for v in range(n_uavs):
        if v != u:
            own[v] = _own(sites_m, user_m, gain, height2, v, chosen[v])
            others[v] = max(quiet[chosen[v]] - own[v], 1.0)
            alone[v] = khz[v] * PER_LN * np.log(1.0 + own[v] / others[v])
            top += alone[v]
    best, now, to = -np.inf, -np.inf, chosen[u]
    for i in range(-1, quiet.shape[0]):
        k = chosen[u] if i < 0 else i
        if i >= 0 and taken[k] != 0:
            continue
        value = khz[u] * PER_LN * np.log(1.0 + _own(sites_m, user_m, gain, height2, u, k) / quiet[k]) - cost[u, k] + top
        x, y = sites_m[0, k], sites_m[1, k]
        for v in range(n_uavs):
            if value <= best + LEAST_GAIN:
                break  # what is disturbed further only takes more away
            if v != u:
                j = chosen[v]
                de, dn = x - user_m[0, j], y - user_m[1, j]
                heard = gain[u, j if gain.shape[1] > 1 else 0] / (de * de + dn * dn + height2[u])
                value -= alone[v] - khz[v] * PER_LN * np.log(1.0 + own[v] / (others[v] + heard))
        if i < 0:
            now = value
        if value > best + LEAST_GAIN:
            best, to = value, k
    return int(to), float(best - now)
