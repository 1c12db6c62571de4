"""Users that change UAVs one at a time, by what each change is really worth less its toll.

For all utilities but a plain `sum`, and for that with minimum rates: bands are shared by the tangent at the present
rates, as in `shares.py`, and the gain of a change is counted in the utility itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import PER_USER, POOLED, SUM, Arena, Ints, entry, hide_absent, kernel
from skyfolio.planner.fast.exchange import THOROUGH
from skyfolio.planner.fast.market import Market, enter_slot, fill, market_of
from skyfolio.planner.fast.rates import keep_pins, settle_low, slot_signals
from skyfolio.planner.fast.shares import candidates

Flags = NDArray[np.bool_]
LEAST_GAIN = 1e-9
"""kbit/s: what a change must gain beyond rounding."""
STEEPEST = 600.0
"""exp of more than this is out of the question."""


class Slot(NamedTuple):
    """One slot's users, (K,) each: UAV, kHz, kbit/s, UAV before (-1: free of toll), whether it had bandwidth then."""

    serving: Ints
    khz: Array
    rate: Array
    before: Ints
    served: Flags


class Book(NamedTuple):
    """Sums of the utility over all slots that count.

    low, z, number: (K,), a rate, sum exp(mu (rate - low)), and how many slots; `pooled` and `sum` use the first entries
    only. slot: (N,), kbit/s, the sum rates; all_slots: (1,), how many count.
    """

    low: Array
    z: Array
    number: Array
    slot: Array
    all_slots: Array


@entry
def trade_links(arena: Arena, path: Array, serving: Ints, khz: Array, before: Ints, served: Flags, toll: float) -> int:
    """Let users change UAVs, in place, one in one slot at a time, where that gains more than it costs; how many did.

    serving, khz, before, served: (N, K), as in `Tolls`. Bands are shared anew by the tangent at the present rates.
    """
    n_users, n_uavs = arena.user_m.shape[2], path.shape[2]
    signal, total, loudest = np.empty((n_uavs, n_users)), np.empty(n_users), np.empty(n_users)
    rate, market = np.empty((path.shape[0], n_users)), market_of(arena, np.zeros(n_users))
    for n in range(path.shape[0]):
        _efficiencies(arena, path, n, signal, total, loudest, serving[n], market.eff)
        for k in range(n_users):
            rate[n, k] = min(khz[n, k] * market.eff[k, serving[n, k]], arena.demand[k])
    book, changes, spare = _book_of(arena, rate), 0, np.empty(n_users)
    for n in range(path.shape[0]):
        slot = Slot(serving[n], khz[n], rate[n], before[n], served[n])
        _efficiencies(arena, path, n, signal, total, loudest, slot.serving, market.eff)
        _weigh(arena, book, market.log_weight)
        enter_slot(arena, market, n)
        for u in range(n_uavs):
            _gather(market, slot.serving, u)
            fill(market, u, spare)  # for the price of its band
            _trade(arena, market, book, slot, n, -1, u, toll)
        for k in range(n_users):
            old = slot.before[k]
            if old >= 0 and old != slot.serving[k] and market.eff[k, old] > 0.0:
                changes += _trade(arena, market, book, slot, n, k, old, toll)
            for v in range(n_uavs):
                if v != slot.serving[k] and _may_gain(arena, market, k, v):
                    changes += _trade(arena, market, book, slot, n, k, v, toll)
    return changes


@kernel
def _efficiencies(
    arena: Arena, path: Array, n: int, signal: Array, total: Array, loudest: Array, serving: Ints, eff: Array
) -> None:
    """Write bit/s/Hz of all pairs of slot n into `eff` (K, U), 0 where pins or its end forbid a UAV."""
    slot_signals(arena, path[n], n, signal, total)
    if arena.has_pinned_to:
        keep_pins(arena, n, signal)
    if arena.has_absent:
        hide_absent(arena, n, signal)
    fresh = signal.shape[0] == 0  # everybody has a UAV
    candidates(signal, total, serving, fresh, loudest, eff)


@kernel
def _book_of(arena: Arena, rate: Array) -> Book:
    """Add up the utility's sums at these rates (N, K) and in the past."""
    n_slots, n_users = rate.shape
    book = Book(np.zeros(n_users), np.zeros(n_users), np.zeros(n_users), np.zeros(n_slots), np.zeros(1))
    book.all_slots[0] = n_slots - arena.counted + arena.n_past
    for n in range(n_slots):
        for k in range(n_users):
            book.slot[n] += arena.weight[k] * rate[n, k]
    rows = n_users if arena.kind == PER_USER else 1
    book.low[:rows] = np.inf
    for k in range(n_users):
        row = k if arena.kind == PER_USER else 0
        past = arena.n_past > 0 and (arena.kind != SUM or k == 0) and arena.past_count[k] > 0
        if past:
            book.low[row] = min(book.low[row], arena.past_low[k])
        for n in range(arena.counted, n_slots):
            if _counts(arena, n, k):
                book.low[row] = min(book.low[row], book.slot[n] if arena.kind == SUM else rate[n, k])
    settle_low(book.low, np.bool_(False))
    for k in range(n_users if arena.kind != SUM else 1):
        _enter_user(arena, rate, book, k)
    return book


@kernel
def _enter_user(arena: Arena, rate: Array, book: Book, k: int) -> None:
    """Add what user k, or the sum rate, adds to the sums."""
    row, times = k if arena.kind == PER_USER else 0, _times(arena, k)
    if arena.n_past > 0 and arena.past_count[k] > 0:
        book.z[row] += times * arena.past_sum[k] * np.exp(arena.mu * (arena.past_low[k] - book.low[row]))
        book.number[row] += times * arena.past_count[k]
    for n in range(arena.counted, rate.shape[0]):
        if _counts(arena, n, k):
            x = book.slot[n] if arena.kind == SUM else rate[n, k]
            book.z[row] += times * np.exp(arena.mu * (x - book.low[row]))
            book.number[row] += times


@kernel
def _counts(arena: Arena, n: int, k: int) -> bool:
    """Return whether a rate of user k in slot n is in an expectation of rates, or of sum rates."""
    return bool(arena.kind == SUM or not arena.has_absent or arena.absent[n, k] == 0)


@kernel
def _times(arena: Arena, k: int) -> float:
    """Return how often each rate of user k counts in the expectation of all users; 1 in other expectations."""
    return float(arena.weight[k]) if arena.kind == POOLED else 1.0


@kernel
def _weigh(arena: Arena, book: Book, log_weight: Array) -> None:
    """Log of the tangent's weights, the greatest 0, into `log_weight` (K,)."""
    if arena.kind == PER_USER:
        top = -np.inf
        for k in range(log_weight.shape[0]):
            log_weight[k] = np.log(arena.weight[k])
            if book.number[k] > 0.0:
                log_weight[k] += np.log(book.number[k] / book.z[k]) - arena.mu * book.low[k]
            top = max(top, log_weight[k])
        for k in range(log_weight.shape[0]):
            log_weight[k] -= top
    else:
        for k in range(log_weight.shape[0]):
            log_weight[k] = np.log(arena.weight[k])


@kernel
def _gather(market: Market, serving: Ints, u: int) -> None:
    """Note the members of UAV u."""
    count = 0
    for k in range(serving.shape[0]):
        if serving[k] == u:
            market.member[u, count] = k
            count += 1
    market.size[u] = count


@kernel
def _may_gain(arena: Arena, market: Market, k: int, v: int) -> bool:
    """Return whether user k might take bandwidth from UAV v: at the price of its band, or because users are few."""
    worth = market.eff[k, v]
    if worth <= 0.0:
        return False
    if market.eff.shape[0] <= THOROUGH or arena.has_floors or market.size[v] == 0:
        return True
    if arena.kind == SUM:
        worth *= arena.weight[k]
    else:
        worth *= -arena.mu * np.exp(market.log_weight[k])
    return bool(worth > market.price[v])


@kernel
def _trade(arena: Arena, market: Market, book: Book, slot: Slot, n: int, k: int, v: int, toll: float) -> bool:
    """Let user k (-1: none) change to UAV v in slot n, and share both bands anew; undone unless it gains.

    Who leaves a minimum rate less unmet gains whatever it costs.
    """
    u, khz = slot.serving[k] if k >= 0 else v, slot.khz.copy()
    if k >= 0:
        slot.serving[k] = v
    _share(market, slot, u, v, khz)
    met = _met(market, slot, u, v, khz) if arena.has_minimum else 0
    if met >= 0:
        gain = _utility_gain(arena, market, book, slot, n, u, v, khz) - toll * _more_paying(slot, k, u, v, khz)
        if met > 0 or gain > LEAST_GAIN:
            _enter(arena, market, book, slot, n, u, v, khz)
            return k >= 0
    if k >= 0:
        slot.serving[k] = u
    _share(market, slot, u, v, khz)
    return False


@kernel
def _share(market: Market, slot: Slot, u: int, v: int, khz: Array) -> None:
    """Share the bands of two UAVs among the users that they serve now, into `khz` (K,)."""
    for one in (u, v):
        _gather(market, slot.serving, one)
        fill(market, one, khz)


@kernel
def _met(market: Market, slot: Slot, u: int, v: int, khz: Array) -> int:
    """Return how many more minimum rates would be met."""
    more = 0
    for j in range(khz.shape[0]):
        if slot.serving[j] == u or slot.serving[j] == v:
            least = market.least[j] * (1.0 - 1e-12)
            more += (khz[j] * market.eff[j, slot.serving[j]] >= least) - (slot.rate[j] >= least)
    return more


@kernel
def _more_paying(slot: Slot, k: int, u: int, v: int, khz: Array) -> float:
    """Return how many more users would pay the toll of a change, where user k changed from UAV u to v."""
    more = 0.0
    for j in range(khz.shape[0]):
        if slot.serving[j] == u or slot.serving[j] == v:
            was = u if j == k else slot.serving[j]
            more += _pays(slot, j, slot.serving[j], khz[j]) - _pays(slot, j, was, slot.khz[j])
    return more


@kernel
def _utility_gain(arena: Arena, market: Market, book: Book, slot: Slot, n: int, u: int, v: int, khz: Array) -> float:
    """Return what the utility gains when the users of two UAVs get these bands, kbit/s."""
    if n < arena.counted:
        return 0.0
    gain, change, more = 0.0, 0.0, 0.0
    for j in range(khz.shape[0]):
        if slot.serving[j] != u and slot.serving[j] != v:
            continue
        rate = khz[j] * market.eff[j, slot.serving[j]]
        more += arena.weight[j] * (rate - slot.rate[j])
        if arena.kind == PER_USER and book.number[j] > 0.0:
            gain += arena.weight[j] * _worth(arena, book, j, _change(arena, rate, slot.rate[j], book.low[j]))
        elif arena.kind == POOLED:
            change += arena.weight[j] * _change(arena, rate, slot.rate[j], book.low[0])
    if arena.kind == POOLED:
        return _worth(arena, book, 0, change)
    return _sum_gain(arena, book, n, more) if arena.kind == SUM else gain


@kernel
def _pays(slot: Slot, j: int, serving: int, khz: float) -> float:
    """Return 1 where user j pays the toll of a change."""
    concerned = slot.before[j] >= 0 and (slot.served[j] or khz > 0.0)
    return 1.0 if concerned and serving != slot.before[j] else 0.0


@kernel
def _change(arena: Arena, rate: float, was: float, low: float) -> float:
    """Return by how much the sum of exp(mu (rate - low)) changes; infinite where it cannot be computed."""
    if arena.mu * (rate - low) > STEEPEST:
        return np.inf
    return float(np.exp(arena.mu * (rate - low)) - np.exp(arena.mu * (was - low)))


@kernel
def _worth(arena: Arena, book: Book, row: int, change: float) -> float:
    """Return what a change of one sum is worth, kbit/s of utility."""
    z = max(book.z[row] + change, 1e-300)
    return float(book.number[row] / (book.all_slots[0] * arena.mu) * np.log(z / book.z[row]))


@kernel
def _sum_gain(arena: Arena, book: Book, n: int, delta: float) -> float:
    """Return what a change of one slot's sum rate is worth, kbit/s of utility."""
    if arena.mu == 0.0:
        return float(delta / book.all_slots[0])
    return _worth(arena, book, 0, _change(arena, book.slot[n] + delta, book.slot[n], book.low[0]))


@kernel
def _enter(arena: Arena, market: Market, book: Book, slot: Slot, n: int, u: int, v: int, khz: Array) -> None:
    """Keep a trade: bands, rates and sums."""
    before = book.slot[n]
    for j in range(slot.serving.shape[0]):
        if slot.serving[j] != u and slot.serving[j] != v:
            continue
        rate = khz[j] * market.eff[j, slot.serving[j]]
        book.slot[n] += arena.weight[j] * (rate - slot.rate[j])
        if arena.kind != SUM and n >= arena.counted:
            row = j if arena.kind == PER_USER else 0
            book.z[row] += _times(arena, j) * _change(arena, rate, slot.rate[j], book.low[row])
        slot.khz[j], slot.rate[j] = khz[j], rate
    if arena.kind == SUM and arena.mu < 0.0 and n >= arena.counted:
        book.z[0] += _change(arena, book.slot[n], before, book.low[0])
    _weigh(arena, book, market.log_weight)
