"""Which users to hover over, quickly: UAVs change users while the sum of spectral efficiencies grows.

Everybody's interference is kept in sums, so that a move costs U steps, and most moves none: what a user could give at
most, with no other UAV disturbed by it, is known from one sum. What flying there costs is taken off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Ints, entry, kernel, smooth
from skyfolio.planner.fast.elementary import PER_LN2, log

SWEEPS = 20
LEAST_GAIN = 1e-6
NEAR = 2.0
"""A UAV looks around again when something changed within so many times the distance between UAVs."""
AT_ONCE = 8
"""UAVs whose losses are added up before it is asked whether they are too much."""


class Guess(NamedTuple):
    """What is known while one UAV looks for a user; the other UAVs' entries are of the users that they hover over.

    quiet: (K,), 1 + SNR at every user from all others. hope: (K,), kbit/s that all would come to without interference.
    east, north, gain: (U,), where those users are, metres, and the gain of the UAV that looks to them, m^2.
    khz, own, others, alone: (U,), band, SNR and interference without that UAV, and what that comes to; 0 for itself.
    even: whether all bands are equal; even_khz: then that band, per nat. who, value, x, y, loud, silent: (K,), scratch.
    """

    quiet: Array
    hope: Array
    east: Array
    north: Array
    gain: Array
    khz: Array
    own: Array
    others: Array
    alone: Array
    even: bool
    even_khz: float
    who: Ints
    value: Array
    x: Array
    y: Array
    loud: Array
    silent: Array


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
    guess = _guess_of(khz, n_users)
    near2_m = NEAR * NEAR * _extent_m2(sites_m) / n_uavs
    for u in range(n_uavs):
        taken[chosen[u]] = 1
        _hear(sites_m, user_m, gain[u], height2[u], chosen[u], row)
        heard += row
    stale = np.ones(n_uavs, dtype=np.int64)
    for _ in range(SWEEPS):
        gained = 0.0
        for u in range(n_uavs):
            if stale[u] == 0:
                continue
            stale[u] = 0
            _hear(sites_m, user_m, gain[u], height2[u], chosen[u], row)
            for k in range(n_users):
                guess.quiet[k] = max(heard[k] - row[k], 1.0)
            top = _look_around(sites_m, user_m, gain, height2, khz, chosen, u, guess)
            _hope(sites_m, user_m, gain[u], height2[u], khz[u], cost[u], top, guess)
            to, better = _best_user(sites_m, height2[u], chosen[u], taken, guess)
            if to != chosen[u]:
                taken[chosen[u]], taken[to] = 0, 1
                _wake(sites_m, chosen, chosen[u], near2_m, stale)
                _wake(sites_m, chosen, to, near2_m, stale)
                chosen[u] = to
                gained += better
                _hear(sites_m, user_m, gain[u], height2[u], to, row)
                for k in range(n_users):
                    heard[k] = guess.quiet[k] + row[k]
        if gained <= LEAST_GAIN:
            break
    total = 0.0
    for u in range(n_uavs):
        k = chosen[u]
        signal = _own(sites_m, user_m, gain, height2, u, k)
        total += khz[u] * PER_LN2 * np.log(1.0 + signal / max(heard[k] - signal, 1.0)) - cost[u, k]
    return float(total)


@kernel
def _extent_m2(sites_m: Array) -> float:
    """Return the area of the rectangle that holds all sites."""
    return float((sites_m[0].max() - sites_m[0].min()) * (sites_m[1].max() - sites_m[1].min()))


@kernel
def _wake(sites_m: Array, chosen: Ints, k: int, near2_m: float, stale: Ints) -> None:
    """Note that somebody came to user k or left it: UAVs near by look around again."""
    for v in range(chosen.shape[0]):
        de, dn = sites_m[0, chosen[v]] - sites_m[0, k], sites_m[1, chosen[v]] - sites_m[1, k]
        if de * de + dn * dn <= near2_m:
            stale[v] = 1


@kernel
def _guess_of(khz: Array, n_users: int) -> Guess:
    """Tables of the right size."""
    n_uavs, even = khz.shape[0], True
    for u in range(n_uavs):
        even = even and khz[u] == khz[0]
    return Guess(
        np.empty(n_users),
        np.empty(n_users),
        np.empty(n_uavs),
        np.empty(n_uavs),
        np.empty(n_uavs),
        np.empty(n_uavs),
        np.empty(n_uavs),
        np.empty(n_uavs),
        np.empty(n_uavs),
        even,
        khz[0] * PER_LN2,
        np.empty(max(2, n_users), dtype=np.int64),
        np.empty(max(2, n_users)),
        np.empty(max(2, n_users)),
        np.empty(max(2, n_users)),
        np.empty(max(2, n_users)),
        np.empty(max(2, n_users)),
    )


@smooth
def _own(sites_m: Array, user_m: Array, gain: Array, height2: Array, u: int, k: int) -> float:
    de, dn = sites_m[0, k] - user_m[0, k], sites_m[1, k] - user_m[1, k]
    return float(gain[u, k if gain.shape[1] > 1 else 0] / (de * de + dn * dn + height2[u]))


@smooth
def _hear(sites_m: Array, user_m: Array, gain: Array, height2: float, over: int, row: Array) -> None:
    """Return the SNR of a UAV over user `over` at every user, into `row` (K,). gain: (1 or K,)."""
    x, y, shared, same = sites_m[0, over], sites_m[1, over], gain.shape[0] == 1, gain[0]
    east, north = user_m[0], user_m[1]
    for k in range(row.shape[0]):
        de, dn = x - east[k], y - north[k]
        row[k] = (same if shared else gain[k]) / (de * de + dn * dn + height2)


@kernel
def _look_around(
    sites_m: Array, user_m: Array, gain: Array, height2: Array, khz: Array, chosen: Ints, u: int, guess: Guess
) -> float:
    """Fill in what all but UAV u have if it is not there, and return what that comes to, kbit/s."""
    top, n_users = 0.0, user_m.shape[1]
    for v in range(chosen.shape[0]):
        j = chosen[v]
        guess.east[v], guess.north[v] = user_m[0, j], user_m[1, j]
        guess.gain[v] = gain[u, j if gain.shape[1] == n_users else 0]
        guess.khz[v], guess.own[v], guess.others[v], guess.alone[v] = 0.0, 0.0, 1.0, 0.0
        if v != u:
            guess.khz[v], guess.own[v] = khz[v] * PER_LN2, _own(sites_m, user_m, gain, height2, v, j)
            guess.others[v] = max(guess.quiet[j] - guess.own[v], 1.0)
            guess.alone[v] = guess.khz[v] * log(1.0 + guess.own[v] / guess.others[v])
            top += guess.alone[v]
    return top


@smooth
def _hope(
    sites_m: Array, user_m: Array, gain: Array, height2: float, khz: float, cost: Array, top: float, guess: Guess
) -> None:
    """Write what all come to if a UAV hovers over each user and disturbs no other, into `guess.hope`."""
    shared, same, quiet, hope = gain.shape[0] == 1, gain[0], guess.quiet, guess.hope
    for k in range(hope.shape[0]):
        de, dn = sites_m[0, k] - user_m[0, k], sites_m[1, k] - user_m[1, k]
        own = (same if shared else gain[k]) / (de * de + dn * dn + height2)
        hope[k] = khz * PER_LN2 * log(1.0 + own / quiet[k]) - cost[k] + top


@kernel
def _best_user(sites_m: Array, height2: float, current: int, taken: Ints, guess: Guess) -> tuple[int, float]:
    """Return the user that a UAV should hover over, everybody else staying, and by how much that is better than now.

    The current and the most hopeful one come first: most others need no look then, and fewer with each few UAVs whose
    losses are known.
    """
    first = current
    for k in range(taken.shape[0]):
        if taken[k] == 0 and (guess.hope[k] > guess.hope[first] or first == current):
            first = k
    guess.who[0], guess.who[1] = current, first
    _disturb(sites_m, height2, 2, -np.inf, guess)
    now, best, to = guess.value[0], guess.value[0], current
    if first != current and guess.value[1] > best + LEAST_GAIN:
        best, to = guess.value[1], first
    count = 0
    for k in range(taken.shape[0]):
        if taken[k] == 0 and k != first and guess.hope[k] > best + LEAST_GAIN:
            guess.who[count] = k
            count += 1
    count = _disturb(sites_m, height2, count, best + LEAST_GAIN, guess)
    for i in range(count):
        if guess.value[i] > best + LEAST_GAIN:
            best, to = guess.value[i], guess.who[i]
    return int(to), float(best - now)


@kernel
def _disturb(sites_m: Array, height2: float, count: int, least: float, guess: Guess) -> int:
    """Write what all come to with a UAV over each of the first `count` users of `who` into `value`.

    Users with which that is no more than `least` are left out; how many stay.
    """
    who, value, x, y, n_uavs = guess.who, guess.value, guess.x, guess.y, guess.own.shape[0]
    for i in range(count):
        value[i], x[i], y[i] = guess.hope[who[i]], sites_m[0, who[i]], sites_m[1, who[i]]
    for begin in range(0, n_uavs, AT_ONCE):
        end, before, count = min(begin + AT_ONCE, n_uavs), count, 0
        if guess.even:
            _lose_evenly(height2, begin, end, before, guess)
        else:
            _lose(height2, begin, end, before, guess)
        for i in range(before):
            if value[i] > least:
                who[count], value[count], x[count], y[count] = who[i], value[i], x[i], y[i]
                count += 1
    return count


@smooth
def _lose(height2: float, begin: int, end: int, count: int, guess: Guess) -> None:
    """Take what UAVs [begin, end) lose off `value`."""
    x, y, value = guess.x, guess.y, guess.value
    for v in range(begin, end):
        east, north, gain, khz = guess.east[v], guess.north[v], guess.gain[v], guess.khz[v]
        own, others, alone = guess.own[v], guess.others[v], guess.alone[v]
        for i in range(count):
            de, dn = x[i] - east, y[i] - north
            heard = gain / (de * de + dn * dn + height2)
            value[i] -= alone - khz * log(1.0 + own / (others + heard))


@smooth
def _lose_evenly(height2: float, begin: int, end: int, count: int, guess: Guess) -> None:
    """Do the same where all bands are equal: with one logarithm of the product of what is within, and no quotients."""
    x, y, value, loud, quiet, alone = guess.x, guess.y, guess.value, guess.loud, guess.silent, 0.0
    for i in range(count):
        loud[i] = quiet[i] = 1.0
    for v in range(begin, end):
        east, north, gain = guess.east[v], guess.north[v], guess.gain[v]
        others, both = guess.others[v], guess.others[v] + guess.own[v]
        alone += guess.alone[v]
        for i in range(count):
            de, dn = x[i] - east, y[i] - north
            away2 = de * de + dn * dn + height2
            loud[i] *= both * away2 + gain
            quiet[i] *= others * away2 + gain
    khz = guess.even_khz
    for i in range(count):
        value[i] -= alone - khz * log(loud[i] / quiet[i])
