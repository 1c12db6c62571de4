"""One slot with several users for each UAV: users change places while it helps, bands follow (`market.py`)."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import SUM, Ints, kernel, smooth
from skyfolio.planner.fast.elementary import exp, log
from skyfolio.planner.fast.market import Market, fill, join, leave

SWEEPS = 4
THOROUGH = 16
"""Up to so many users, every move and exchange that can help is tried."""
LEAST_GAIN = 1e-12
"""Relative: what costs less by no more than this is the same."""


@kernel
def share_slot(market: Market, serving: Ints, khz: Array) -> None:
    """Improve `serving` (K,) of a slot, and fill `khz` (K,): moves of single users until none helps."""
    n_users, n_uavs = market.eff.shape
    for u in range(n_uavs):
        market.size[u] = 0
    for k in range(n_users):
        join(market, k, serving[k])
    for u in range(n_uavs):
        fill(market, u, khz)
    # Fields are read once, out here: inside the loops numba would count references to each of them.
    eff, weight, log_weight, price = market.eff, market.weight, market.log_weight, market.price
    band, least, decay = market.band, market.least, 0.0 if market.kind == SUM else -market.mu
    times, demand, has_demand = market.times, market.demand, market.has_demand
    for _ in range(SWEEPS):
        moved = False
        for k in range(n_users):
            u = serving[k]
            if decay > 0.0 and least[k] == 0.0 and not has_demand:
                to = _promising(decay, eff, weight[k], log_weight[k], price, band, k, u)
            else:
                to = _promising_with_floor(
                    decay, eff, times[k], log_weight[k], price, band, least[k], demand[k], k, u, khz[k]
                )
            if to >= 0 and _try_move(market, k, to, serving, khz):
                moved = True
        if not moved:
            return


@kernel
def exchange(market: Market, serving: Ints, khz: Array) -> None:
    """After `share_slot`: moves of one user and exchanges of two until none helps.

    Beside the one that the prices promise most of, `share_slot` tries no other.
    """
    for u in range(market.eff.shape[1]):
        _charge(market, u)
    for _ in range(SWEEPS):
        if not _thorough_sweep(market, serving, khz):
            return


@kernel
def _thorough_sweep(market: Market, serving: Ints, khz: Array) -> bool:
    """Try every move and every exchange that can help; whether any was kept."""
    n_users, n_uavs = market.eff.shape
    blind, changed = market.has_minimum, False
    for k in range(n_users):
        for to in range(n_uavs):
            u = serving[k]
            if to != u and market.eff[k, to] > 0.0 and (blind or _can_move(market, k, u, to)):
                changed = _recharged(market, u, to, _try_move(market, k, to, serving, khz)) or changed
        for other in range(k):
            u, to = serving[k], serving[other]
            if to != u and (blind or _can_exchange(market, k, u, other, to)):
                kept = _try_exchange(market, k, other, serving, khz)
                changed = _recharged(market, u, to, kept) or changed
    return changed


@kernel
def _charge(market: Market, u: int) -> None:
    """Write what each user would add to the minimised sum at UAV u into `market.charge`, at the present price.

    Whatever the price, what the users of a UAV cost is no less than the sum of these less the price of the band: that
    is its Lagrangian bound, which is reached at the price of those whom it serves. So with other users it costs more by
    no less than the difference of their charges. Without users there is no price, and the first one takes the band,
    or as much of it as it asks for.
    """
    decay, price, band = -market.mu, market.price[u], market.band[u]
    if market.kind == SUM:
        _charge_for_sum(market, u)
    elif market.has_demand:
        _charge_up_to_demand(market, u)
    elif market.size[u] > 0:
        _charge_by_price(decay, market.weight, market.eff, price, u, market.charge)
    else:
        for k in range(market.weight.shape[0]):
            market.charge[k, u] = market.weight[k] * exp(-decay * market.eff[k, u] * band)


@smooth
def _charge_by_price(decay: float, weight: Array, eff: Array, price: float, u: int, charge: Array) -> None:
    for k in range(weight.shape[0]):
        slope = decay * eff[k, u]
        worth = max(weight[k] * slope, price)
        taken = price * (1.0 + log(worth / price)) / slope if price > 0.0 and slope > 0.0 else 0.0
        charge[k, u] = taken if weight[k] * slope > price else weight[k]


@kernel
def _charge_for_sum(market: Market, u: int) -> None:
    """Do the same where bands are worth the rates: who is worth more than the price takes all that it asks for."""
    price, band = market.price[u] if market.size[u] > 0 else 0.0, market.band[u]
    for k in range(market.eff.shape[0]):
        eff, charge = market.eff[k, u], 0.0
        if eff > 0.0:
            charge = min(0.0, price - market.times[k] * eff) * min(band, market.demand[k] / eff)
        market.charge[k, u] = charge


@kernel
def _charge_up_to_demand(market: Market, u: int) -> None:
    """Do the same where users take no more than they ask for, nor than there is."""
    price, band = market.price[u] if market.size[u] > 0 else 0.0, market.band[u]
    for k in range(market.eff.shape[0]):
        eff, worth = market.eff[k, u], market.weight[k]
        slope = -market.mu * eff
        if worth * slope <= price:
            market.charge[k, u] = worth
            continue
        taken = min(band, market.demand[k] / eff)
        if price > 0.0:
            taken = min(taken, log(worth * slope / price) / slope)
        market.charge[k, u] = worth * exp(-slope * taken) + price * taken


@kernel
def _recharged(market: Market, u: int, to: int, changed: bool) -> bool:
    """Return whether the users of two UAVs have `changed`, after charging what they cost now."""
    if changed:
        _charge(market, u)
        _charge(market, to)
    return changed


@kernel
def _can_move(market: Market, k: int, u: int, to: int) -> bool:
    """Return whether the slot may cost less with user k at UAV `to` instead of u."""
    more = market.charge[k, to] - market.charge[k, u]
    return bool(more < -LEAST_GAIN * abs(market.cost[u] + market.cost[to]))


@kernel
def _can_exchange(market: Market, k: int, u: int, other: int, to: int) -> bool:
    """Return whether the slot may cost less when user k of UAV u and the other one of UAV `to` change places."""
    charge = market.charge
    more = charge[k, to] - charge[k, u] + charge[other, u] - charge[other, to]
    return bool(more < -LEAST_GAIN * abs(market.cost[u] + market.cost[to]))


@kernel
def _promising(
    decay: float, eff: Array, weight: float, log_weight: float, price: Array, band: Array, k: int, u: int
) -> int:
    """Return the UAV where user k would cost less than at u, at the present prices, or -1.

    Most users would take no band anywhere, which is found out without a logarithm.
    """
    best, least = -1, weight
    worth = weight * decay
    if worth * eff[k, u] > price[u]:
        least = _cost(decay * eff[k, u], log_weight, price[u], band[u], 0.0, np.inf)
    least *= 1.0 - 1e-12
    for i in range(eff.shape[1]):
        if i != u and worth * eff[k, i] > price[i]:
            promised = _cost(decay * eff[k, i], log_weight, price[i], band[i], 0.0, np.inf)
            if promised < least:
                least, best = promised, i
    return best


@kernel
def _cost(decay: float, log_weight: float, price: float, band: float, least_khz: float, most_khz: float) -> float:
    """Return what a user adds to the minimised sum, and its band to the price, when it takes what suits it."""
    if price == 0.0:  # of a UAV without users, or with band that none of them asks for
        return float(exp(log_weight - decay * min(band, most_khz)))
    wanted = (log_weight + log(decay / price)) / decay
    if least_khz <= wanted <= most_khz:
        return price / decay + price * wanted  # what its exponential has come down to
    taken = min(max(wanted, least_khz), most_khz)
    return float(exp(log_weight - decay * taken) + price * taken)


@kernel
def _promising_with_floor(
    decay: float,
    eff: Array,
    worth: float,
    log_weight: float,
    price: Array,
    band: Array,
    min_kbps: float,
    demand: float,
    k: int,
    u: int,
    khz: float,
) -> int:
    """Return the same under `sum`, and for users who leave a UAV that cannot give them their minimum rate.

    worth: the user's weight, of a kbit/s under `sum`. demand: kbit/s beyond which it takes no band.
    """
    best, least = -1, np.inf
    for i in range(-1, eff.shape[1]):
        to = u if i < 0 else i
        if i == u or eff[k, to] <= 0.0 or (i < 0 and khz * eff[k, u] < min_kbps * (1.0 - 1e-12)):
            continue
        least_khz, most_khz = min_kbps / eff[k, to], demand / eff[k, to]
        if decay == 0.0:
            more = max(0.0, worth * eff[k, to] - price[to])
            promised = least_khz * price[to] - worth * min_kbps - more * min(band[to], most_khz - least_khz)
        else:
            promised = _cost(decay * eff[k, to], log_weight, price[to], band[to], least_khz, most_khz)
        if promised < least - 1e-12 * abs(promised):
            least, best = promised, i
    return best


@kernel
def _try_move(market: Market, k: int, to: int, serving: Ints, khz: Array) -> bool:
    """Move user k to UAV `to` when the slot really costs less for it; whether it moved."""
    return _try(market, k, to, -1, serving, khz)


@kernel
def _try_exchange(market: Market, k: int, other: int, serving: Ints, khz: Array) -> bool:
    """Let two users change places when the slot really costs less for it; whether they did."""
    to = serving[other]
    if market.eff[k, to] <= 0.0 or market.eff[other, serving[k]] <= 0.0:
        return False
    return _try(market, k, to, other, serving, khz)


@kernel
def _try(market: Market, k: int, to: int, other: int, serving: Ints, khz: Array) -> bool:
    """Move k to UAV `to`, and `other`, unless it is -1, from there to where k was; undone when that costs more."""
    u = serving[k]
    _remember(market, u, khz)
    _remember(market, to, khz)
    cost_u, price_u, cost_to, price_to = market.cost[u], market.price[u], market.cost[to], market.price[to]
    _trade(market, k, u, to, other)
    fill(market, u, khz)
    fill(market, to, khz)
    before = cost_u + cost_to
    if market.cost[u] + market.cost[to] < before - LEAST_GAIN * abs(before):
        serving[k] = to
        if other >= 0:
            serving[other] = u
        return True
    _trade(market, k, to, u, other)
    market.cost[u], market.price[u], market.cost[to], market.price[to] = cost_u, price_u, cost_to, price_to
    _restore(market, u, khz)
    _restore(market, to, khz)
    return False


@kernel
def _trade(market: Market, k: int, u: int, to: int, other: int) -> None:
    leave(market, k, u)
    join(market, k, to)
    if other >= 0:
        leave(market, other, to)
        join(market, other, u)


@kernel
def _remember(market: Market, u: int, khz: Array) -> None:
    for i in range(market.size[u]):
        market.was[market.member[u, i]] = khz[market.member[u, i]]


@kernel
def _restore(market: Market, u: int, khz: Array) -> None:
    for i in range(market.size[u]):
        khz[market.member[u, i]] = market.was[market.member[u, i]]
