"""Rates of the links (eqs. 1-4), the utility of them, and their gradient with respect to the positions."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import PER_USER, POOLED, SUM, Arena, Flag, Ints, Links, kernel, smooth
from skyfolio.planner.fast.draws import draw_signals, equivalent_signals, mean_log, pull_draws

PER_LN = 1.0 / np.log(2.0)


@smooth
def slot_signals(arena: Arena, at: Array, n: int, signal: Array, total: Array) -> None:
    """SNR of every pair of slot n into `signal` (U, K), and 1 + their sum over UAVs into `total` (K,).

    at: (2, U), the positions in slot n. Of rates averaged over draws they are what gives the same rate in one draw.
    """
    n_uavs, n_users = signal.shape
    east, north = arena.user_m[0], arena.user_m[1]
    if arena.draws.shape[2] > 0:
        equivalent_signals(arena, at, n, signal, total)
        return
    for k in range(n_users):
        total[k] = 1.0
    for u in range(n_uavs):
        x, y, h2, gain, row = at[0, u], at[1, u], arena.height2[u], arena.gain[n, u], signal[u]
        if arena.fading.shape[0] == 0:
            for k in range(n_users):
                de, dn = x - east[k], y - north[k]
                s = gain / (de * de + dn * dn + h2)
                row[k] = s
                total[k] += s
        else:
            faded = arena.fading[n, u]
            for k in range(n_users):
                de, dn = x - east[k], y - north[k]
                s = faded[k] / (de * de + dn * dn + h2)
                row[k] = s
                total[k] += s


@kernel
def keep_pins(arena: Arena, n: int, signal: Array) -> None:
    """Set the signals (U, K) of slot n to 0 where a user is pinned to another UAV: no link is made without one.

    What the UAV adds to the interference stays in the totals.
    """
    for k in range(signal.shape[1]):
        given = arena.pinned_to[n, k]
        for u in range(signal.shape[0]):
            if given >= 0 and u != given:
                signal[u, k] = 0.0


@smooth
def _mean_signals(
    path: Array, gain: Array, height2: Array, east: float, north: float, n: int, near: Array, signal: Array
) -> None:
    """1/d^2 and SNR of every UAV at (east, north) in slot n, into `near` and `signal`, both (U,)."""
    for i in range(near.shape[0]):
        de, dn = path[n, 0, i] - east, path[n, 1, i] - north
        near[i] = 1.0 / (de * de + dn * dn + height2[i])
        signal[i] = gain[n, i] * near[i]


@smooth
def _faded_signals(
    path: Array, fading: Array, height2: Array, east: float, north: float, n: int, k: int, near: Array, signal: Array
) -> None:
    """Return the same with the sampled gains of user k."""
    for i in range(near.shape[0]):
        de, dn = path[n, 0, i] - east, path[n, 1, i] - north
        near[i] = 1.0 / (de * de + dn * dn + height2[i])
        signal[i] = fading[n, i, k] * near[i]


@smooth
def _sum_without(signal: Array, u: int) -> float:
    """1 + the sum of all but entry u, which is set to 0: nothing is subtracted, so nothing cancels."""
    signal[u] = 0.0
    total = 1.0
    for i in range(signal.shape[0]):
        total += signal[i]
    return total


@smooth
def link_rates(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """Rate of every link, kbit/s, into `rate` (N, W). path: (N, 2, U)."""
    # Fields are read once, out here: inside the loops numba would count references to each of them.
    gain, fading, draws, user_m, height2 = arena.gain, arena.fading, arena.draws, arena.user_m, arena.height2
    users, uavs, khz, count = links.user, links.uav, links.khz, links.used
    near, signal, own_s, others_s = _scratch(path.shape[2], draws.shape[2])
    sampled, expected = fading.shape[0] > 0, draws.shape[2] > 0
    for n in range(path.shape[0]):
        for j in range(count[n]):
            if khz[n, j] == 0.0:
                rate[n, j] = 0.0
                continue
            u, k = uavs[n, j], users[n, j]
            if sampled:
                _faded_signals(path, fading, height2, user_m[0, k], user_m[1, k], n, k, near, signal)
            else:
                _mean_signals(path, gain, height2, user_m[0, k], user_m[1, k], n, near, signal)
            if expected:
                draw_signals(signal, draws[k], u, own_s, others_s)
                rate[n, j] = khz[n, j] * PER_LN * mean_log(own_s, others_s)
                continue
            own = signal[u]
            others = _sum_without(signal, u)
            rate[n, j] = khz[n, j] * PER_LN * np.log((own + others) / others)


@smooth
def gradient(arena: Arena, path: Array, links: Links, weight: Array, slope: Array) -> None:
    """sum_j weight[n, j] d rate[n, j] / d path[n] into `slope` (N, 2, U); 0 in slot 0, which is fixed."""
    gain, fading, draws, user_m, height2 = arena.gain, arena.fading, arena.draws, arena.user_m, arena.height2
    users, uavs, khz, count = links.user, links.uav, links.khz, links.used
    near, signal, own_s, others_s = _scratch(path.shape[2], draws.shape[2])
    sampled, expected = fading.shape[0] > 0, draws.shape[2] > 0
    for n in range(path.shape[0]):
        for i in range(path.shape[2]):
            slope[n, 0, i] = slope[n, 1, i] = 0.0
        if n == 0:
            continue
        for j in range(count[n]):
            scale = weight[n, j] * khz[n, j] * PER_LN
            if scale == 0.0:
                continue
            u, k = uavs[n, j], users[n, j]
            if sampled:
                _faded_signals(path, fading, height2, user_m[0, k], user_m[1, k], n, k, near, signal)
            else:
                _mean_signals(path, gain, height2, user_m[0, k], user_m[1, k], n, near, signal)
            if expected:
                draw_signals(signal, draws[k], u, own_s, others_s)
                pull_draws(
                    path, slope, n, u, user_m[0, k], user_m[1, k], scale, draws[k], own_s, others_s, near, signal
                )
                continue
            own = signal[u]
            others = _sum_without(signal, u)
            _pull(path, slope, n, u, user_m[0, k], user_m[1, k], scale, own, others, near, signal)


@kernel
def _scratch(n_uavs: int, n_draws: int) -> tuple[Array, Array, Array, Array]:
    """Return room for 1/d^2 and SNR of every UAV, and for both sides of the SINR in every draw."""
    return np.empty(n_uavs), np.empty(n_uavs), np.empty(n_draws), np.empty(n_draws)


@smooth
def _pull(
    path: Array,
    slope: Array,
    n: int,
    u: int,
    east: float,
    north: float,
    scale: float,
    own: float,
    others: float,
    near: Array,
    signal: Array,
) -> None:
    """Add the slope of one link: it pulls its UAV u to the user and pushes the others away."""
    push = 2.0 * scale * own / ((own + others) * others)
    for i in range(near.shape[0]):
        strength = push * signal[i] * near[i]
        slope[n, 0, i] += strength * (path[n, 0, i] - east)
        slope[n, 1, i] += strength * (path[n, 1, i] - north)
    strength = 2.0 * scale * own * near[u] / (own + others)
    slope[n, 0, u] -= strength * (path[n, 0, u] - east)
    slope[n, 1, u] -= strength * (path[n, 1, u] - north)


@kernel
def value(arena: Arena, links: Links, rate: Array, moving: Flag, weight: Array) -> float:
    """Return the utility in kbit/s, and d utility / d rate of each link into `weight` (N, W).

    With `moving`, `sum` and `pooled` leave out what no path can change, the past and slot 0: a monotone function of
    the same, which keeps its precision where they would drown it.
    """
    if arena.kind == SUM:
        return _sum_value(arena, links, rate, moving, weight)
    return _user_value(arena, links, rate, moving, weight)


@kernel
def _sum_value(arena: Arena, links: Links, rate: Array, moving: Flag, weight: Array) -> float:
    n_slots = rate.shape[0]
    first = max(1, arena.counted) if moving else arena.counted
    n_past, past_sum, least = (0, 0.0, np.inf) if moving else (arena.n_past, arena.past_sum[0], arena.past_low[0])
    n_all = n_slots - first + n_past
    slot, total = np.zeros(n_slots), past_sum
    for n in range(first, n_slots):
        for j in range(links.used[n]):
            slot[n] += rate[n, j]
        total += slot[n]
        least = min(least, slot[n])
    z = past_sum * np.exp(arena.mu * (arena.past_low[0] - least)) if n_past > 0 else 0.0
    for n in range(n_slots):
        share = 1.0 if arena.mu == 0.0 else np.exp(arena.mu * (slot[n] - least))
        if n < first:
            share = 0.0
        z += share
        slot[n] = share
    if arena.mu == 0.0:
        z = float(n_all)
    for n in range(n_slots):
        for j in range(links.used[n]):
            weight[n, j] = slot[n] / z
    if n_all == 0:
        return 0.0
    return float(total / n_all if arena.mu == 0.0 else least + np.log(z / n_all) / arena.mu)


@kernel
def _user_value(arena: Arena, links: Links, rate: Array, moving: Flag, weight: Array) -> float:
    """`per_user` has one expectation for each user, `pooled` one for all; both count users without a link as 0.

    Each counts by the share of the slots in which there was somebody: `count / n_all`.
    """
    n_users, mu = arena.user_m.shape[1], arena.mu
    low, z, count = np.empty(n_users), np.empty(n_users), np.empty(n_users)
    n_all = user_sums(arena, links, rate, moving and arena.kind == POOLED, low, z, count)
    if n_all == 0:
        return 0.0
    for n in range(rate.shape[0]):
        counts = n >= arena.counted and not (moving and n == 0)
        for j in range(links.used[n]):
            k = links.user[n, j]
            weight[n, j] = count[k] / n_all * np.exp(mu * (rate[n, j] - low[k])) / z[k] if counts else 0.0
    result = 0.0
    for k in range(n_users if arena.kind == PER_USER else 1):
        result += count[k] / n_all * (low[k] + np.log(z[k] / count[k]) / mu)
    return result


@kernel
def user_sums(arena: Arena, links: Links, rate: Array, moving: Flag, low: Array, z: Array, count: Array) -> int:
    """Write each user's lowest rate, sum exp(mu (rate - least)) and number of slots into `low`, `z`, `count`: (K,).

    Returns how many slots count in all. `pooled` has the same for all users: all rates of all users together. With
    `moving`, the past and slot 0 are left out.
    """
    n_slots, n_users, mu = rate.shape[0], arena.user_m.shape[1], arena.mu
    first = max(1, arena.counted) if moving else arena.counted
    n_past = 0 if moving else arena.n_past
    unserved = _least_rates(arena, links, rate, first, n_past, low)
    for k in range(n_users):
        z[k] = unserved[k] * np.exp(-mu * low[k]) if unserved[k] > 0 else 0.0
        count[k] = n_slots - first
        if n_past > 0:
            count[k] += arena.past_count[k]
        if n_past > 0 and arena.past_count[k] > 0:
            z[k] += arena.past_sum[k] * np.exp(mu * (arena.past_low[k] - low[k]))
    for n in range(first, n_slots):
        for j in range(links.used[n]):
            k = links.user[n, j]
            z[k] += np.exp(mu * (rate[n, j] - low[k]))
    if arena.kind == POOLED:
        total, number = 0.0, 0.0
        for k in range(n_users):
            total += z[k]
            number += count[k]
        for k in range(n_users):
            z[k], count[k] = total, number
    return int(n_slots - first + n_past)


@kernel
def _least_rates(arena: Arena, links: Links, rate: Array, first: int, n_past: int, low: Array) -> Ints:
    """Write the least counted rate of each user into `low` (K,), for `pooled` of all.

    Returns in how many slots each has no link.
    """
    n_slots, n_users = rate.shape[0], low.shape[0]
    unserved = np.empty(n_users, dtype=np.int64)
    for k in range(n_users):
        unserved[k] = n_slots - first
        low[k] = arena.past_low[k] if n_past > 0 else np.inf
    for n in range(first, n_slots):
        for j in range(links.used[n]):
            k = links.user[n, j]
            unserved[k] -= 1
            low[k] = min(low[k], rate[n, j])
    least = np.inf
    for k in range(n_users):
        if unserved[k] > 0:
            low[k] = min(low[k], 0.0)
        least = min(least, low[k])
    if arena.kind == POOLED:
        for k in range(n_users):
            low[k] = least
    return unserved
