"""`sum`: the best association and bandwidth of a slot, exactly, as a linear assignment.

Rates add up, so a UAV gives its whole band to one user, and (6b) makes the users distinct: a UAVs x users assignment.
It is solved by shortest augmenting paths (Crouse, doi:10.1109/TAES.2016.140952), with two shortcuts that keep it
exact: a UAV whose best user is free takes it without a search (the user's price is 0 then, and can only fall), and the
logarithms are taken only for the UAVs that a search visits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Ints, Links, hide_absent, kernel, smooth
from skyfolio.planner.fast.rates import keep_pins, slot_signals


class Search(NamedTuple):
    """Scratch of one assignment of R rows to C columns, R <= C: costs where `ready`, prices, who holds what."""

    cost: Array
    ready: Ints
    row_price: Array
    price: Array
    holder: Ints
    shortest: Array
    reached_from: Ints
    done: Ints
    visited: Ints
    chosen: Ints


@kernel
def search_of(rows: int, columns: int) -> Search:
    """Scratch of the right size."""
    return Search(
        np.empty((rows, columns)),
        np.empty(rows, dtype=np.int64),
        np.empty(rows),
        np.empty(columns),
        np.empty(columns, dtype=np.int64),
        np.empty(columns),
        np.empty(columns, dtype=np.int64),
        np.empty(columns, dtype=np.int64),
        np.empty(rows, dtype=np.int64),
        np.empty(rows, dtype=np.int64),
    )


@kernel
def match_all(arena: Arena, path: Array, links: Links) -> None:
    """Return the best links of every slot at `path` (N, 2, U)."""
    n_uavs, n_users = path.shape[2], arena.user_m.shape[2]
    signal, total, inverse = np.empty((n_uavs, n_users)), np.empty(n_users), np.empty(n_users)
    by_uav = search_of(n_uavs, max(n_users, n_uavs))
    by_user = search_of(n_users, max(n_users, n_uavs))
    for n in range(path.shape[0]):
        slot_signals(arena, path[n], n, signal, total)
        if arena.has_pinned_to:
            keep_pins(arena, n, signal)
        if arena.has_absent:
            hide_absent(arena, n, signal)
        flying = 0
        for u in range(n_uavs):
            flying += arena.last[u] >= n
        if flying <= n_users:
            match(signal, total, inverse, arena.khz, arena.weight, arena.has_weights, by_uav)
            _link_uavs(arena, links, n, by_uav.chosen, signal)
        else:
            _match_users(signal, total, arena.khz, arena.weight, by_user)
            _link_users(arena, links, n, by_user.chosen, signal)


@kernel
def _link_uavs(arena: Arena, links: Links, n: int, user_of: Ints, signal: Array) -> None:
    count = 0
    for u in range(user_of.shape[0]):
        if user_of[u] >= 0 and signal[u, user_of[u]] > 0.0:
            links.user[n, count], links.uav[n, count], links.khz[n, count] = user_of[u], u, arena.khz[u]
            count += 1
    links.used[n] = count


@kernel
def _link_users(arena: Arena, links: Links, n: int, uav_of: Ints, signal: Array) -> None:
    count = 0
    for k in range(uav_of.shape[0]):
        u = uav_of[k]
        if signal[u, k] > 0.0:
            links.user[n, count], links.uav[n, count], links.khz[n, count] = k, u, arena.khz[u]
            count += 1
    links.used[n] = count


@kernel
def match(
    signal: Array, total: Array, inverse: Array, khz: Array, weight: Array, weighted: bool, search: Search
) -> None:
    """Distinct users of the greatest sum rate into `search.chosen` (U,), -1 for UAVs without a signal.

    signal: (U, K) SNR, of at most K UAVs above 0; total: (K,), 1 + their sum; inverse: (K,), scratch. weight: (K,), of
    the rates in the sum; weighted: whether they differ, so that the greatest SINR need not be the greatest worth.
    """
    _clear(search)
    for k in range(total.shape[0]):
        inverse[k] = 1.0 / total[k]
    for u in range(signal.shape[0]):
        best, k = _greatest(signal[u], inverse)
        if best <= 0.0:
            continue
        if search.holder[k] < 0 and not weighted:
            search.holder[k], search.chosen[u] = u, k
            search.row_price[u] = -_rate(signal[u, k], total[k], khz[u])
        else:
            _augment(u, signal, total, khz, weight, search)


@kernel
def _match_users(signal: Array, total: Array, khz: Array, weight: Array, search: Search) -> None:
    """Return the same where UAVs outnumber users: each user gets its UAV, in `search.chosen` (K,)."""
    n_uavs, n_users = signal.shape
    _clear(search)
    for k in range(n_users):
        for u in range(n_uavs):
            search.cost[k, u] = -_rate(signal[u, k], total[k], khz[u]) * weight[k]
        search.ready[k] = 1
        _augment(k, signal, total, khz, weight, search)


@kernel
def _clear(search: Search) -> None:
    for i in range(search.ready.shape[0]):
        search.ready[i] = 0
        search.chosen[i] = -1
        search.row_price[i] = 0.0
    for j in range(search.price.shape[0]):
        search.price[j] = 0.0
        search.holder[j] = -1


@smooth
def _greatest(row: Array, inverse: Array) -> tuple[float, int]:
    """Return the greatest share of the received power and its user: SINR grows with it."""
    best = 0.0
    for i in range(row.shape[0]):
        best = max(best, row[i] * inverse[i])
    for i in range(row.shape[0]):
        if row[i] * inverse[i] >= best:
            return best, i
    return 0.0, 0


@kernel
def _rate(signal: float, total: float, khz: float) -> float:
    """log(1 + SINR) times the band: the rate but for a constant factor. Interference and noise are at least 1."""
    others = max(total - signal, 1.0)
    return float(khz * np.log((others + signal) / others))


@kernel
def _augment(row: int, signal: Array, total: Array, khz: Array, weight: Array, search: Search) -> None:
    """Give `row` a column along the cheapest alternating path, and update the prices."""
    least, sink, i = 0.0, -1, row
    for j in range(search.price.shape[0]):
        search.shortest[j], search.done[j] = np.inf, 0
    for u in range(search.visited.shape[0]):
        search.visited[u] = 0
    while sink < 0:
        search.visited[i] = 1
        if search.ready[i] == 0:
            for k in range(total.shape[0]):
                search.cost[i, k] = -_rate(signal[i, k], total[k], khz[i]) * weight[k]
            for k in range(total.shape[0], search.price.shape[0]):
                search.cost[i, k] = np.inf
            search.ready[i] = 1
        nearest = _relax(i, least, search)
        least = search.shortest[nearest]
        search.done[nearest] = 1
        if search.holder[nearest] < 0:
            sink = nearest
        else:
            i = search.holder[nearest]
    _reprice(row, least, search)
    j = sink
    while True:
        i = search.reached_from[j]
        search.holder[j] = i
        search.chosen[i], j = j, search.chosen[i]
        if i == row:
            return


@kernel
def _relax(i: int, least: float, search: Search) -> int:
    """Shorten the ways to the open columns over row i, and return the nearest of them, a free one if it ties."""
    cost, price, shortest, done, holder = search.cost, search.price, search.shortest, search.done, search.holder
    lowest, nearest, base = np.inf, (-1), least - search.row_price[i]
    for j in range(price.shape[0]):
        if done[j] != 0:
            continue
        length = base + cost[i, j] - price[j]
        if length < shortest[j]:
            shortest[j], search.reached_from[j] = length, i
        if shortest[j] < lowest or (shortest[j] == lowest and holder[j] < 0):
            lowest, nearest = shortest[j], j
    return nearest


@kernel
def _reprice(row: int, least: float, search: Search) -> None:
    search.row_price[row] += least
    for u in range(search.visited.shape[0]):
        if search.visited[u] != 0 and u != row:
            search.row_price[u] += least - search.shortest[search.chosen[u]]
    for j in range(search.price.shape[0]):
        if search.done[j] != 0:
            search.price[j] -= least - search.shortest[j]
