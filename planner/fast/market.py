"""One UAV's band in one slot: whose it is, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import SUM, Arena, Ints, kernel, smooth
from skyfolio.planner.fast.elementary import exp, log

ROUNDING = 4e-15
"""Relative: shares that add up to this much more than the band are scaled back to it."""
UNMET = 1e9
"""What leaving one minimum rate unmet costs, beside which every utility is small."""


class Market(NamedTuple):
    """One slot's state. eff: (K, U) bit/s/Hz, 0 for pairs out of the question; weight, log_weight: (K,), `w`.

    member: (U, K), the users of each UAV, the first size[u] (U,) of them. cost, price: (U,), what the users of each
    UAV add to the minimised sum, and what a kHz is worth there, lambda (for `sum` its rate). decay, first, given,
    place: (K,), scratch of the members of one UAV; was: (K,), bands before a trial. charge: (K, U), what each would
    add at the present prices (`exchange.py`).
    """

    eff: Array
    weight: Array
    log_weight: Array
    member: Ints
    size: Ints
    cost: Array
    price: Array
    decay: Array
    first: Array
    given: Array
    place: Ints
    was: Array
    charge: Array


@kernel
def market_of(n_uavs: int, log_weight: Array) -> Market:
    """Tables of the right size, with the weights exp(log_weight) (K,)."""
    n_users = log_weight.shape[0]
    return Market(
        np.zeros((n_users, n_uavs)),
        np.exp(log_weight),
        log_weight,
        np.empty((n_uavs, n_users), dtype=np.int64),
        np.empty(n_uavs, dtype=np.int64),
        np.empty(n_uavs),
        np.empty(n_uavs),
        np.empty(n_users),
        np.empty(n_users),
        np.empty(n_users),
        np.empty(n_users, dtype=np.int64),
        np.empty(n_users),
        np.empty((n_users, n_uavs)),
    )


@kernel
def join(market: Market, k: int, u: int) -> None:
    """Make user k a member of UAV u."""
    market.member[u, market.size[u]] = k
    market.size[u] += 1


@kernel
def leave(market: Market, k: int, u: int) -> None:
    """Make user k, a member of UAV u, one no longer."""
    last = market.size[u] - 1
    for i in range(last):
        if market.member[u, i] == k:
            market.member[u, i] = market.member[u, last]
            break
    market.size[u] = last


@kernel
def fill(arena: Arena, market: Market, u: int, khz: Array) -> None:
    """Share the band of UAV u among its users, minimum rates first, into `khz` (K,), and note cost and price."""
    count, members, eff = market.size[u], market.member[u], market.eff
    market.cost[u] = market.price[u] = 0.0
    if count == 0:
        return
    left, cost = arena.khz[u], 0.0
    for i in range(count):
        khz[members[i]] = 0.0
    if arena.has_minimum:
        left, cost = _reserve(arena, market, u, khz)
    if arena.kind == SUM:
        top = members[0]
        for i in range(count):
            if eff[members[i], u] > eff[top, u]:
                top = members[i]
        khz[top] += left
        for i in range(count):
            cost -= khz[members[i]] * eff[members[i], u]
        market.price[u] = eff[top, u]
    else:
        cost += _share(arena, market, u, left, khz)
    market.cost[u] = cost


@kernel
def _reserve(arena: Arena, market: Market, u: int, khz: Array) -> tuple[float, float]:
    """Give each member what its minimum rate takes, the cheapest first while it lasts: (kHz left, penalty)."""
    left, waiting, members, count = arena.khz[u], 0, market.member[u], market.size[u]
    for i in range(count):
        waiting += arena.min_kbps[members[i]] > 0.0
    while waiting > 0:
        cheapest, least = -1, np.inf
        for i in range(count):
            k = members[i]
            if arena.min_kbps[k] > 0.0 and khz[k] == 0.0 and arena.min_kbps[k] < least * market.eff[k, u]:
                cheapest, least = k, arena.min_kbps[k] / market.eff[k, u]
        if cheapest < 0 or least > left:
            return left, UNMET * waiting
        khz[cheapest] = least
        left -= least
        waiting -= 1
    return left, 0.0


@kernel
def _share(arena: Arena, market: Market, u: int, left: float, khz: Array) -> float:
    """Add `left` kHz to what `khz` (K,) gives the members of UAV u, note the price, and return what they cost then."""
    count, members, floors = market.size[u], market.member[u], arena.has_minimum
    decay, first, given, place, weight = market.decay, market.first, market.given, market.place, market.weight
    for i in range(count):
        k = members[i]
        decay[i], first[i], place[i] = -arena.mu * market.eff[k, u], market.log_weight[k], i
    _next_worth(decay, first, count)
    for i in range(count if floors else 0):
        first[i] -= decay[i] * khz[members[i]]
    level = water_fill(decay, first, left, place, count, given)
    cost, price = 0.0, exp(level)
    market.price[u] = price
    for i in range(count):
        k = members[i]
        if given[i] > 0.0:
            cost += price / decay[i]  # what its exponential has come down to
        else:
            cost += exp(market.log_weight[k] - decay[i] * khz[k]) if floors else weight[k]
        khz[k] += given[i]
    return cost


@smooth
def _next_worth(decay: Array, first: Array, count: int) -> None:
    """From the logarithms of the weights to those of what the first kHz is worth: nothing without a signal."""
    for i in range(count):
        first[i] = first[i] + log(decay[i]) if decay[i] > 0.0 else -np.inf


@kernel
def water_fill(decay: Array, first: Array, left: float, place: Ints, count: int, given: Array) -> float:
    """Share `left` kHz among `count` users, minimising sum w exp(-decay khz): kHz into `given`; log lambda.

    decay: (count,); first: (count,), the log of what the next kHz is worth, log(w decay) less decay times what a user
    has. Users for whom that is less than lambda drop out until none does: finite and exact, as in projecting on a
    simplex. place: (count,), scratch, 0, 1, 2 ...
    """
    active, level = count, -np.inf
    for i in range(count):
        given[i] = 0.0
    while True:
        worth, width, kept = 0.0, 0.0, 0
        for j in range(active):
            i = place[j]
            if first[i] > level:
                slope = 1.0 / decay[i]
                worth += first[i] * slope
                width += slope
                place[kept] = i
                kept += 1
        if kept == 0:
            return level
        settled = kept == active and level > -np.inf
        level, active = (worth - left) / width, kept
        if settled:
            break
    total = 0.0
    for j in range(active):
        i = place[j]
        given[i] = max(0.0, (first[i] - level) / decay[i])
        total += given[i]
    if total > left * (1.0 + ROUNDING):  # at tiny decays the differences cancel
        for j in range(active):
            given[place[j]] *= left / total
    return level
