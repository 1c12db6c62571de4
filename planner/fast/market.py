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
    add at the present prices (`exchange.py`). least: (K,), kbit/s, the minimum rates of users who are there. most, who:
    (K,), scratch: lids and users that have not reached them. The rest is the arena's, kept here because a call that
    is given a whole arena takes longer than what most of these kernels do: band: (U,), kHz; times: (K,), as how many
    users each counts; demand: (K,), kbit/s.
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
    least: Array
    most: Array
    who: Ints
    band: Array
    times: Array
    demand: Array
    mu: float
    kind: int
    has_minimum: bool
    has_demand: bool


@kernel
def market_of(arena: Arena, log_weight: Array) -> Market:
    """Tables of the right size, with the weights exp(log_weight) (K,)."""
    n_uavs, n_users = arena.khz.shape[0], log_weight.shape[0]
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
        np.zeros(n_users),
        np.empty(n_users),
        np.empty(n_users, dtype=np.int64),
        arena.khz,
        arena.weight,
        arena.demand,
        arena.mu,
        arena.kind,
        arena.has_minimum,
        arena.has_demand,
    )


@kernel
def enter_slot(arena: Arena, market: Market, n: int) -> None:
    """Note the minimum rates of slot n."""
    for k in range(market.least.shape[0]):
        there = not arena.has_absent or arena.absent[n, k] == 0
        market.least[k] = arena.min_kbps[k] if there else 0.0


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
def fill(market: Market, u: int, khz: Array) -> None:
    """Share the band of UAV u among its users, minimum rates first, into `khz` (K,), and note cost and price.

    No user gets band beyond what it asks for; what no user of the UAV asks for stays free, at a price of 0.
    """
    count, members, eff = market.size[u], market.member[u], market.eff
    market.cost[u] = market.price[u] = 0.0
    if count == 0:
        return
    left, cost = market.band[u], 0.0
    for i in range(count):
        khz[members[i]] = 0.0
    if market.has_minimum:
        left, cost = _reserve(market, u, khz)
    if market.has_demand:
        cost += serve_in_order(market, u, left, khz) if market.kind == SUM else share_up_to_demand(market, u, left, khz)
    elif market.kind == SUM:
        top, weight = members[0], market.times
        for i in range(count):
            if weight[members[i]] * eff[members[i], u] > weight[top] * eff[top, u]:
                top = members[i]
        if eff[top, u] > 0.0:
            khz[top] += left
        for i in range(count):
            cost -= khz[members[i]] * (weight[members[i]] * eff[members[i], u])
        market.price[u] = weight[top] * eff[top, u]
    else:
        cost += _share(market, u, left, khz)
    market.cost[u] = cost


@kernel
def serve_in_order(market: Market, u: int, left: float, khz: Array) -> float:
    """Add `left` kHz to what `khz` (K,) gives the users of UAV u, who is worth most per kHz first, up to its demand.

    Notes the price, and returns what the users cost then: less what their rates are worth. That is exact, as in a
    knapsack whose last item may be cut.
    """
    count, members, eff, weight, demand = market.size[u], market.member[u], market.eff, market.times, market.demand
    while True:
        top, best = -1, 0.0
        for i in range(count):
            k = members[i]
            worth = weight[k] * eff[k, u]
            if worth > best and khz[k] * eff[k, u] < demand[k] * (1.0 - 1e-12):
                top, best = k, worth
        if top < 0 or left <= 0.0:
            break
        more = min(left, demand[top] / eff[top, u] - khz[top])
        if more == left:
            khz[top] += left
            left = 0.0
        else:
            khz[top] = demand[top] / eff[top, u]
            left -= more
    market.price[u] = best
    cost = 0.0
    for i in range(count):
        cost -= khz[members[i]] * (weight[members[i]] * eff[members[i], u])
    return cost


@kernel
def share_up_to_demand(market: Market, u: int, left: float, khz: Array) -> float:
    """Do as `_share`, up to what each user asks for.

    Water-filling with lids: who would get more than it asks for gets that, and the rest is shared anew among the
    others. The more is left for them the lower is the price, so that no lid that was reached is left again: exact
    after at most as many rounds as there are users.
    """
    members, decay, first = market.member[u], market.decay, market.first
    given, place, most, who = market.given, market.place, market.most, market.who
    count = market.size[u]
    for i in range(count):
        k = members[i]
        who[i], decay[i], first[i] = k, -market.mu * market.eff[k, u], market.log_weight[k]
        most[i] = 0.0
        if market.eff[k, u] > 0.0:
            most[i] = max(0.0, market.demand[k] / market.eff[k, u] - khz[k])
    _next_worth(decay, first, count)
    for i in range(count):
        first[i] -= decay[i] * khz[who[i]] if decay[i] > 0.0 else 0.0
    waiting, settled, level = count, False, -np.inf
    while not settled:
        for i in range(waiting):
            place[i] = i
        level = water_fill(decay, first, left, place, waiting, given)
        settled, kept = True, 0
        for i in range(waiting):
            if given[i] >= most[i] and decay[i] > 0.0:
                khz[who[i]] += most[i]
                left = max(0.0, left - most[i])
                settled = False
            else:
                who[kept], decay[kept], first[kept] = who[i], decay[i], first[i]
                most[kept], given[kept] = most[i], given[i]
                kept += 1
        waiting = kept
    for i in range(waiting):
        khz[who[i]] += given[i]
    market.price[u] = exp(level) if level > -np.inf else 0.0
    cost = 0.0
    for i in range(count):
        k = members[i]
        cost += exp(market.log_weight[k] + market.mu * market.eff[k, u] * khz[k])
    return cost


@kernel
def _reserve(market: Market, u: int, khz: Array) -> tuple[float, float]:
    """Give each member what its minimum rate takes, the cheapest first while it lasts: (kHz left, penalty)."""
    left, waiting, members, count = market.band[u], 0, market.member[u], market.size[u]
    for i in range(count):
        waiting += market.least[members[i]] > 0.0
    while waiting > 0:
        cheapest, least = -1, np.inf
        for i in range(count):
            k = members[i]
            if market.least[k] > 0.0 and khz[k] == 0.0 and market.least[k] < least * market.eff[k, u]:
                cheapest, least = k, market.least[k] / market.eff[k, u]
        if cheapest < 0 or least > left:
            return left, UNMET * waiting
        khz[cheapest] = least
        left -= least
        waiting -= 1
    return left, 0.0


@kernel
def _share(market: Market, u: int, left: float, khz: Array) -> float:
    """Add `left` kHz to what `khz` (K,) gives the members of UAV u, note the price, and return what they cost then."""
    count, members, floors = market.size[u], market.member[u], market.has_minimum
    decay, first, given, place, weight = market.decay, market.first, market.given, market.place, market.weight
    for i in range(count):
        k = members[i]
        decay[i], first[i], place[i] = -market.mu * market.eff[k, u], market.log_weight[k], i
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
