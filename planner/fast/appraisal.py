"""What a set of hover points is worth, from the moments of `snapshots.py`: bands are shared in closed form."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import PER_USER, SUM, Arena, Ints, entry, inlined, kernel, smooth
from skyfolio.planner.fast.elementary import PER_LN2, exp, log
from skyfolio.planner.fast.snapshots import Snapshots, gather, keep

UNMET = 1e3
"""kbit/s that it costs to lack a whole band for the minimum rates: far more than any other move can gain."""
TINY = 1e-300
TANGENTS = 3
"""Minorants in a row when `per_user` is looked at anew."""
SAME = 1e-9
"""Prices whose logarithms differ by less are the same."""


@entry
def look(arena: Arena, shots: Snapshots, place_m: Array) -> float:
    """Take the snapshots with everyone bound for `place_m` (2, U), metres; what they are worth, as in `worth`."""
    shots.log_weight[:] = np.log(arena.weight)
    shots.level[:] = -np.inf
    gather(arena, shots, place_m)
    value = worth(arena, shots)
    for _ in range(TANGENTS if arena.kind == PER_USER else 0):
        weigh(arena, shots)
        value = worth(arena, shots)
    keep(shots)
    return value


@kernel
def weigh(arena: Arena, shots: Snapshots) -> None:
    """Let the next moves be judged by what they change beside the places that were looked at last."""
    if arena.kind == PER_USER:
        for k in range(shots.z.shape[0]):
            shots.log_weight[k] = np.log(arena.weight[k]) - np.log(max(shots.z[k], TINY))


@kernel
def worth(arena: Arena, shots: Snapshots) -> float:
    """Return the utility over the moments, kbit/s, less a penalty for minimum rates: comparable between places only."""
    if arena.kind == SUM:
        return _sum_worth(arena, shots)
    shots.z[:] = shots.fixed
    total, penalty, n_all = 0.0, 0.0, 0.0
    for m in range(shots.slot.shape[0]):
        penalty += shots.slots[m] * _share_moment(arena, shots, m)
        n_all += shots.slots[m]
    n_users = shots.z.shape[0]
    if arena.kind == PER_USER:
        for k in range(n_users):
            total += arena.weight[k] * np.log(max(shots.z[k], TINY) / (n_all + shots.fixed[k]))
        return float(total / arena.mu - penalty / n_all)
    number = 0.0
    for k in range(n_users):
        total += arena.weight[k] * shots.z[k]
        number += arena.weight[k]
    return float(number * np.log(max(total, TINY) / (number * n_all)) / arena.mu - penalty / n_all)


@kernel
def _sum_worth(arena: Arena, shots: Snapshots) -> float:
    """Return the soft mean of the sum rates of the moments."""
    least, total, n_all, count = np.inf, 0.0, 0.0, shots.slot.shape[0]
    rates = np.empty(count)
    for m in range(count):
        if arena.has_weights or arena.has_demand:
            rates[m] = _ordered_sum_rate(arena, shots, m)
        else:
            rates[m] = _sum_rate(arena, shots, m)
        least = min(least, rates[m])
        n_all += shots.slots[m]
    for m in range(count):
        total += shots.slots[m] * (rates[m] if arena.mu == 0.0 else np.exp(arena.mu * (rates[m] - least)))
    return float(total / n_all if arena.mu == 0.0 else least + np.log(total / n_all) / arena.mu)


@inlined
def _sum_rate(arena: Arena, shots: Snapshots, m: int) -> float:
    """Give each band to the best of the users that its UAV serves, after the minimum rates."""
    serving, sinr, best, left, rate = shots.heard.serving[m], shots.first, shots.top, shots.left, 0.0
    _sinr(shots.heard.own[m], shots.heard.total[m], sinr)
    for u in range(best.shape[0]):
        best[u], left[u] = 0.0, arena.khz[u]
    for k in range(serving.shape[0]):
        if sinr[k] > best[serving[k]]:
            best[serving[k]] = sinr[k]
    for k in range(serving.shape[0] if arena.has_minimum else 0):
        if arena.min_kbps[k] > 0.0 and not _is_away(arena, sinr[k]):
            left[serving[k]] -= arena.min_kbps[k] / max(PER_LN2 * log(1.0 + sinr[k]), 1e-12)
            rate += arena.min_kbps[k]
    for u in range(best.shape[0]):
        if left[u] < 0.0:
            rate -= UNMET * min(1.0 - left[u] / arena.khz[u], 1e6)
        elif best[u] > 0.0:
            rate += left[u] * PER_LN2 * log(1.0 + best[u])
    return float(rate)


@kernel
def _ordered_sum_rate(arena: Arena, shots: Snapshots, m: int) -> float:
    """Do the same where users differ in weight, or ask for no more than some rate: who is worth most comes first."""
    serving, worth, more, left, rate = shots.heard.serving[m], shots.first, shots.inverse, shots.left, 0.0
    _sinr(shots.heard.own[m], shots.heard.total[m], worth)
    for u in range(left.shape[0]):
        left[u] = arena.khz[u]
    for k in range(serving.shape[0]):
        efficiency = max(PER_LN2 * log(1.0 + worth[k]), 1e-12)
        least = 0.0 if _is_away(arena, worth[k]) else arena.min_kbps[k]
        worth[k] = arena.weight[k] * efficiency
        more[k] = (arena.demand[k] - least) / efficiency
        left[serving[k]] -= least / efficiency
        rate += arena.weight[k] * least
    for u in range(left.shape[0]):
        if left[u] < 0.0:
            rate -= UNMET * min(1.0 - left[u] / arena.khz[u], 1e6)
    return float(rate + _in_order(serving, worth, more, left, shots.top, shots.width))


@kernel
def _is_away(arena: Arena, heard: float) -> bool:
    """Return whether a user receives nothing because it is not there."""
    return bool(arena.has_absent and heard <= 0.0)


@kernel
def _in_order(serving: Ints, worth: Array, more: Array, left: Array, best: Array, who: Array) -> float:
    """Give `left` kHz of each UAV to its users, who is worth most first and up to `more` kHz; what that is worth."""
    rate, asked = 0.0, True
    while asked:
        asked = False
        for u in range(left.shape[0]):
            best[u], who[u] = 0.0, -1.0
        for k in range(serving.shape[0]):
            u = serving[k]
            if left[u] > 0.0 and more[k] > 0.0 and worth[k] > best[u]:
                best[u], who[u] = worth[k], k
        for u in range(left.shape[0]):
            if who[u] >= 0.0:
                asked = True
                given = min(left[u], more[int(who[u])])
                rate += given * best[u]
                left[u] -= given
                more[int(who[u])] = 0.0
    return float(rate)


@smooth
def _sinr(own: Array, total: Array, sinr: Array) -> None:
    for k in range(sinr.shape[0]):
        sinr[k] = own[k] / max(total[k] - own[k], 1.0)


@inlined
def _share_moment(arena: Arena, shots: Snapshots, m: int) -> float:
    """Share the bands of one moment for the minorant with `log_weight`, and add exp(mu rate) of each user to `z`.

    What comes back is the penalty for minimum rates that do not fit.
    """
    heard, serving, level, first = shots.heard, shots.heard.serving[m], shots.level[m], shots.first
    _demands(-arena.mu, shots.log_weight, heard.own[m], heard.total[m], shots.inverse, first)
    for u in range(shots.left.shape[0]):
        shots.left[u] = arena.khz[u]
    short = _reserve(arena, shots, serving, heard.own[m]) if arena.has_minimum else 0.0
    _levels(shots.inverse, first, serving, shots.left, shots.width, shots.top, level)
    for k in range(first.shape[0]):
        first[k] = max(first[k] - level[serving[k]], 0.0)
    if arena.has_minimum:
        for k in range(first.shape[0]):
            first[k] -= arena.mu * arena.min_kbps[k]
    for k in range(first.shape[0] if arena.has_demand else 0):
        first[k] = min(first[k], -arena.mu * arena.demand[k])
    _add_up(shots.slots[m], first, shots.z)
    return short


@smooth
def _demands(decay_per_rate: float, log_weight: Array, own: Array, total: Array, inverse: Array, first: Array) -> None:
    """Write 1 / decay, and the logarithm of what the first kHz is worth to each user, into `inverse` and `first`."""
    for k in range(first.shape[0]):
        others = max(total[k] - own[k], 1.0)
        decay = decay_per_rate * max(PER_LN2 * log((own[k] + others) / others), 1e-12)
        inverse[k] = 1.0 / decay
        first[k] = log_weight[k] + log(decay)


@smooth
def _add_up(slots: float, above: Array, z: Array) -> None:
    for k in range(z.shape[0]):
        z[k] += slots * exp(-above[k])


@kernel
def _reserve(arena: Arena, shots: Snapshots, serving: Ints, own: Array) -> float:
    """Take the minimum rates off `left`, and off what the next kHz is worth; return the penalty for what is short."""
    short, left = 0.0, shots.left
    for k in range(serving.shape[0]):
        if arena.min_kbps[k] > 0.0 and not _is_away(arena, own[k]):
            shots.first[k] += arena.mu * arena.min_kbps[k]
            left[serving[k]] += arena.min_kbps[k] * arena.mu * shots.inverse[k]
    for u in range(left.shape[0]):
        if left[u] < 0.0:
            short += UNMET * min(1.0 - left[u] / arena.khz[u], 1e6)
            left[u] = 0.0
    return short


@kernel
def _levels(inverse: Array, first: Array, serving: Ints, left: Array, width: Array, top: Array, level: Array) -> None:
    """Improve log lambda of each UAV in `level` (U,) until it is right: water-filling for all UAVs at once.

    That is Newton's method on a convex function: whatever the level before, the next is none too high, and then it
    rises, while users that would get less than nothing drop out. A level at which no user is left is too high at
    first; later it is reached, as where minimum rates leave no band.
    """
    changed, rising = True, False
    while changed:
        for u in range(level.shape[0]):
            width[u] = top[u] = 0.0
        for k in range(serving.shape[0]):
            u = serving[k]
            if first[k] > level[u]:
                width[u] += inverse[k]
                top[u] += first[k] * inverse[k]
        changed = False
        for u in range(level.shape[0]):
            risen = (top[u] - left[u]) / width[u] if width[u] > 0.0 else (level[u] if rising else -np.inf)
            if not abs(risen - level[u]) <= SAME and risen != level[u]:
                level[u], changed = risen, True
        rising = True
