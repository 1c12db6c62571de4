"""Rates of the links (eqs. 1-4), the utility of them, and their gradient with respect to the positions."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import PER_USER, POOLED, SUM, Arena, Flag, Ints, Links, kernel, smooth
from skyfolio.planner.fast.draws import equivalent_signals
from skyfolio.planner.fast.elementary import exp
from skyfolio.planner.fast.links_bent import gradient_by_bent_link, rates_by_bent_link, slot_signals_bent
from skyfolio.planner.fast.links_drawn import gradient_by_draw, rates_by_draw
from skyfolio.planner.fast.links_narrow import gradient_by_link, rates_by_link
from skyfolio.planner.fast.links_wide import gradient_by_uav, rates_by_uav

WIDE = 30
"""From so many links in a slot on, the rates of all are computed at once for one UAV after the other."""


@smooth
def slot_signals(arena: Arena, at: Array, n: int, signal: Array, total: Array) -> None:
    """SNR of every pair of slot n into `signal` (U, K), and 1 + their sum over UAVs into `total` (K,).

    at: (2, U), the positions in slot n. Of rates averaged over draws they are what gives the same rate in one draw.
    """
    n_uavs, n_users = signal.shape
    here = arena.user_m[n * arena.per_slot]
    east, north, spread = here[0], here[1], here[2]
    if arena.has_bend:
        slot_signals_bent(arena, at, n, signal, total)
        return
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
                s = gain / (de * de + dn * dn + (h2 + spread[k]))
                row[k] = s
                total[k] += s
        else:
            faded = arena.fading[n, u]
            for k in range(n_users):
                de, dn = x - east[k], y - north[k]
                s = faded[k] / (de * de + dn * dn + (h2 + spread[k]))
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


@kernel
def link_rates(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """Rate of every link, kbit/s, into `rate` (N, W). path: (N, 2, U)."""
    if arena.has_bend:
        rates_by_bent_link(arena, path, links, rate)
    elif arena.draws.shape[2] > 0:
        rates_by_draw(arena, path, links, rate)
    elif rate.shape[1] < WIDE:
        rates_by_link(arena, path, links, rate)
    else:
        rates_by_uav(arena, path, links, rate)


@kernel
def gradient(arena: Arena, path: Array, links: Links, weight: Array, slope: Array) -> None:
    """sum_j weight[n, j] d rate[n, j] / d path[n] into `slope` (N, 2, U); 0 in slot 0, which is fixed."""
    if arena.has_bend:
        gradient_by_bent_link(arena, path, links, weight, slope)
    elif arena.draws.shape[2] > 0:
        gradient_by_draw(arena, path, links, weight, slope)
    elif weight.shape[1] < WIDE:
        gradient_by_link(arena, path, links, weight, slope)
    else:
        gradient_by_uav(arena, path, links, weight, slope)


@kernel
def value(arena: Arena, links: Links, rate: Array, moving: Flag, weight: Array) -> float:
    """Return the utility in kbit/s, and d utility / d rate of each link into `weight` (N, W).

    Rates beyond what users ask for are cut, in `rate` too. With `moving`, `sum` and `pooled` leave out what no path can
    change, the past and slot 0: a monotone function of the same, which keeps its precision where they would drown it.
    """
    if arena.has_demand:
        _cut(arena, links, rate)
    worth = (
        _sum_value(arena, links, rate, moving, weight)
        if arena.kind == SUM
        else _user_value(arena, links, rate, moving, weight)
    )
    if arena.has_demand:
        _ask_no_more(arena, links, rate, weight)
    return worth


@kernel
def _cut(arena: Arena, links: Links, rate: Array) -> None:
    """Cut `rate` (N, W) to what users ask for."""
    for n in range(rate.shape[0]):
        for j in range(links.used[n]):
            rate[n, j] = min(rate[n, j], arena.demand[links.user[n, j]])


@kernel
def _ask_no_more(arena: Arena, links: Links, rate: Array, weight: Array) -> None:
    """Set what more rate is worth to 0 for those who have what they ask for."""
    for n in range(rate.shape[0]):
        for j in range(links.used[n]):
            if rate[n, j] >= arena.demand[links.user[n, j]] * (1.0 - 1e-12):
                weight[n, j] = 0.0


@kernel
def _sum_value(arena: Arena, links: Links, rate: Array, moving: Flag, weight: Array) -> float:
    n_slots = rate.shape[0]
    first = max(1, arena.counted) if moving else arena.counted
    n_past, past_sum, least = (0, 0.0, np.inf) if moving else (arena.n_past, arena.past_sum[0], arena.past_low[0])
    n_all = n_slots - first + n_past
    slot, total, each = np.zeros(n_slots), past_sum, arena.weight
    for n in range(first, n_slots):
        for j in range(links.used[n]):
            slot[n] += each[links.user[n, j]] * rate[n, j]
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
            weight[n, j] = each[links.user[n, j]] * slot[n] / z
    if n_all == 0:
        return 0.0
    return float(total / n_all if arena.mu == 0.0 else least + np.log(z / n_all) / arena.mu)


@kernel
def _user_value(arena: Arena, links: Links, rate: Array, moving: Flag, weight: Array) -> float:
    """`per_user` has one expectation for each user, `pooled` one for all; both count users without a link as 0.

    Each counts by its weight, and by the share of the slots in which there was somebody: `count / n_all`.
    """
    n_users, mu = arena.user_m.shape[2], arena.mu
    low, z, count, share = np.empty(n_users), np.empty(n_users), np.empty(n_users), np.empty(n_users)
    n_all = user_sums(arena, links, rate, moving and arena.kind == POOLED, low, z, count, weight)
    if n_all == 0:
        return 0.0
    each = arena.weight
    for k in range(n_users):
        share[k] = each[k] * count[k] / (n_all * z[k]) if count[k] > 0.0 else 0.0
    user, used, first = links.user, links.used, max(arena.counted, 1) if moving else arena.counted
    for n in range(rate.shape[0]):
        for j in range(used[n]):
            weight[n, j] = weight[n, j] * share[user[n, j]] if n >= first else 0.0
    result = 0.0
    for k in range(n_users if arena.kind == PER_USER else 1):
        if count[k] > 0.0:
            times = each[k] if arena.kind == PER_USER else 1.0
            result += times * (count[k] / n_all * (low[k] + np.log(z[k] / count[k]) / mu))
    return result


@kernel
def user_sums(
    arena: Arena, links: Links, rate: Array, moving: Flag, low: Array, z: Array, count: Array, part: Array
) -> int:
    """Write each user's lowest rate, sum exp(mu (rate - least)) and number of slots into `low`, `z`, `count`: (K,).

    part: (N, W), gets what each link adds to z. Returns how many slots count in all. `pooled` has the same for all
    users: all rates of all users together, by their weights. With `moving`, the past and slot 0 are left out.
    """
    n_slots, n_users, mu = rate.shape[0], arena.user_m.shape[2], arena.mu
    first = max(1, arena.counted) if moving else arena.counted
    n_past = 0 if moving else arena.n_past
    unserved = _least_rates(arena, links, rate, first, n_past, low)
    for k in range(n_users):
        z[k] = unserved[k] * np.exp(-mu * low[k]) if unserved[k] > 0 else 0.0
        count[k] = n_slots - first
        if arena.has_absent:
            count[k] -= _gone(arena, k, first)
        if n_past > 0:
            count[k] += arena.past_count[k]
        if n_past > 0 and arena.past_count[k] > 0:
            z[k] += arena.past_sum[k] * np.exp(mu * (arena.past_low[k] - low[k]))
    _parts(mu, rate, low, links.user, links.used, first, part)
    if arena.has_absent:
        _leave_out(arena, links, first, part)
    user, used = links.user, links.used
    for n in range(first, n_slots):
        for j in range(used[n]):
            z[user[n, j]] += part[n, j]
    if arena.kind == POOLED:
        _pool(arena.weight, z, count)
    return int(n_slots - first + n_past)


@kernel
def _pool(weight: Array, z: Array, count: Array) -> None:
    """Give all users the weighted sums of all."""
    total, number = 0.0, 0.0
    for k in range(z.shape[0]):
        total += weight[k] * z[k]
        number += weight[k] * count[k]
    for k in range(z.shape[0]):
        z[k], count[k] = total, number


@kernel
def _leave_out(arena: Arena, links: Links, first: int, part: Array) -> None:
    """Set to 0 what links of users who are not there would add."""
    for n in range(first, part.shape[0]):
        for j in range(links.used[n]):
            if arena.absent[n, links.user[n, j]] != 0:
                part[n, j] = 0.0


@kernel
def _gone(arena: Arena, k: int, first: int) -> float:
    """Return in how many slots from `first` on user k is not there."""
    gone = arena.gone[k]
    for n in range(first):
        gone -= arena.absent[n, k]
    return float(gone)


@smooth
def _parts(mu: float, rate: Array, low: Array, user: Ints, used: Ints, first: int, part: Array) -> None:
    for n in range(first, rate.shape[0]):
        for j in range(used[n]):
            part[n, j] = exp(mu * (rate[n, j] - low[user[n, j]]))


@kernel
def _least_rates(arena: Arena, links: Links, rate: Array, first: int, n_past: int, low: Array) -> Ints:
    """Write the least counted rate of each user into `low` (K,), for `pooled` of all.

    Returns in how many slots each has no link.
    """
    n_slots, n_users = rate.shape[0], low.shape[0]
    unserved = np.empty(n_users, dtype=np.int64)
    for k in range(n_users):
        unserved[k] = n_slots - first
        if arena.has_absent:
            unserved[k] -= int(_gone(arena, k, first))
        low[k] = arena.past_low[k] if n_past > 0 else np.inf
    for n in range(first, n_slots):
        for j in range(links.used[n]):
            k = links.user[n, j]
            if arena.has_absent and arena.absent[n, k] != 0:
                continue
            unserved[k] -= 1
            low[k] = min(low[k], rate[n, j])
    for k in range(n_users):
        if unserved[k] > 0:
            low[k] = min(low[k], 0.0)
    settle_low(low, arena.kind == POOLED)
    return unserved


@kernel
def settle_low(low: Array, together: Flag) -> None:
    """Give all users the least of all, if `together`, and 0 to those who are never there."""
    least = np.inf
    for k in range(low.shape[0]):
        least = min(least, low[k])
    for k in range(low.shape[0]):
        if together:
            low[k] = least
        if low[k] == np.inf:
            low[k] = 0.0
