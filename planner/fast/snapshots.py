"""What a set of hover points is worth, from a few moments of the straight flights to them.

Which points are good is asked thousands of times, so it is answered without paths: everyone flies straight to its
point, hovers, and flies to its end in time; a handful of moments stand for the slots around them. In each moment a user
belongs to the UAV with the strongest signal, and bands are shared in closed form. Moving one UAV changes one row of the
signals, so that asking again takes K steps a moment and not U K.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import PER_USER, SUM, Arena, Ints, entry, is_pinned, kernel, smooth
from skyfolio.planner.fast.rates import PER_LN

STRETCHES = (0.35, 0.8, 1.5, 3.0, 6.0)
"""Where the stretches that a moment stands for end, in flights to a neighbour; the last one ends with the plan."""
UNMET = 1e3
"""kbit/s that it costs to lack a whole band for the minimum rates: far more than any other move can gain."""
TINY = 1e-300
TANGENTS = 3
"""Minorants in a row when `per_user` is looked at anew."""


class Snapshots(NamedTuple):
    """The fleet at M moments, everyone bound for `place` (2, U). Bands are kHz and rates kbit/s, as in the arena.

    slot: (M,), the slots looked at; slots: (M,), how many each stands for. gain: (M, U, 1) m^2, or (M, U, K) of a
    sampled channel. signal: (M, U, K) SNR; total: (M, K), 1 + their sum; serving: (M, K), the strongest UAV.
    fixed: (K,), sum exp(mu rate) of each user over what no place changes; z: (K,), the same over everything.
    log_weight: (K,), of the minorant by which bands are shared (`shares.py`). inverse, first: (K,), and width, top,
    level, left: (U,), scratch of one moment. kept_*: what a move of up to two UAVs overwrites, to take it back.
    """

    slot: Ints
    slots: Array
    gain: Array
    place: Array
    signal: Array
    total: Array
    serving: Ints
    fixed: Array
    z: Array
    log_weight: Array
    inverse: Array
    first: Array
    width: Array
    top: Array
    level: Array
    left: Array
    kept_signal: Array
    kept_total: Array
    kept_serving: Ints
    kept_place: Array


def snapshots_of(arena: Arena) -> Snapshots:
    """Empty tables of the right size, for the moments that count in `arena`."""
    edges = _edges(arena)
    slot = (edges[:-1] + edges[1:] - 1) // 2
    count, n_uavs, n_users = len(slot), arena.gain.shape[1], arena.user_m.shape[1]
    fixed = np.full(n_users, 1.0 if arena.kind == PER_USER and arena.counted == 0 else 0.0)
    if arena.kind == PER_USER and arena.n_past > 0:
        there = arena.past_count > 0
        fixed[there] += arena.past_sum[there] * np.exp(arena.mu * arena.past_low[there])
    return Snapshots(
        slot=slot,
        slots=np.diff(edges).astype(float),
        gain=_gains(arena, edges, slot),
        place=np.zeros((2, n_uavs)),
        signal=np.zeros((count, n_uavs, n_users)),
        total=np.ones((count, n_users)),
        serving=np.zeros((count, n_users), dtype=np.int64),
        fixed=fixed,
        z=np.ones(n_users),
        log_weight=np.zeros(n_users),
        inverse=np.zeros(n_users),
        first=np.zeros(n_users),
        width=np.zeros(n_uavs),
        top=np.zeros(n_uavs),
        level=np.zeros(n_uavs),
        left=np.zeros(n_uavs),
        kept_signal=np.zeros((2, count, n_users)),
        kept_total=np.zeros((count, n_users)),
        kept_serving=np.zeros((count, n_users), dtype=np.int64),
        kept_place=np.zeros((2, n_uavs)),
    )


def _edges(arena: Arena) -> Ints:
    """Return where the stretches begin, and the end of the last.

    They are fine where UAVs are on their way, coarse where they hover.
    """
    n_slots, n_uavs = arena.gain.shape
    if n_slots <= len(STRETCHES) + 2:
        return np.arange(1, n_slots + 1)
    extent = arena.high - arena.low
    step_m = max(float(np.median(arena.step_m)), 1e-9)
    flight = min(0.5 * float(np.sqrt(extent[0] * extent[1] / n_uavs)) / step_m, float(n_slots))
    ends = [1 + max(i + 1, round(share * flight)) for i, share in enumerate(STRETCHES)]
    edges = [1, n_slots, *ends, *(int(last) + 1 for last in np.unique(arena.last)[:4])]
    if arena.has_ends:
        edges += [n_slots - end for end in ends]
    return np.unique(np.clip(edges, 1, n_slots)).astype(np.int64)


def _gains(arena: Arena, edges: Ints, slot: Ints) -> Array:
    """Return what each moment's signals are computed from; sampled gains are averaged over the stretch."""
    if arena.fading.shape[0] == 0:
        return np.ascontiguousarray(arena.gain[slot][:, :, None])
    means = [arena.fading[begin:end].mean(axis=0) for begin, end in pairwise(edges)]
    return np.ascontiguousarray(np.stack(means))


@entry
def look(arena: Arena, shots: Snapshots, place_m: Array) -> float:
    """Take the snapshots with everyone bound for `place_m` (2, U), metres; what they are worth, as in `worth`."""
    shots.total[:] = 1.0
    shots.signal[:] = 0.0
    shots.serving[:] = 0
    shots.log_weight[:] = 0.0
    for u in range(place_m.shape[1]):
        aim(arena, shots, u, place_m[0, u], place_m[1, u])
    value = worth(arena, shots)
    for _ in range(TANGENTS if arena.kind == PER_USER else 0):
        keep(arena, shots)
        value = worth(arena, shots)
    return value


@kernel
def aim(arena: Arena, shots: Snapshots, u: int, x: float, y: float) -> None:
    """Send UAV u to (x, y) metres instead, in every snapshot."""
    shots.place[0, u], shots.place[1, u] = x, y
    for m in range(shots.slot.shape[0]):
        px, py = position(arena, u, x, y, shots.slot[m])
        signal, total, serving = shots.signal[m], shots.total[m], shots.serving[m]
        _hear_anew(arena.user_m, shots.gain[m, u], px, py, arena.height2[u], signal[u], total, shots.first)
        _follow(signal, serving, shots.first, u)


@smooth
def _hear_anew(
    user_m: Array, gain: Array, x: float, y: float, height2: float, row: Array, total: Array, before: Array
) -> None:
    """Write the SNR of a UAV at (x, y) into `row` (K,), the old into `before`, and add the difference to `total`."""
    east, north, shared = user_m[0], user_m[1], gain.shape[0] == 1
    for k in range(row.shape[0]):
        de, dn = x - east[k], y - north[k]
        s = (gain[0] if shared else gain[k]) / (de * de + dn * dn + height2)
        before[k] = row[k]
        total[k] += s - row[k]
        row[k] = s


@kernel
def _follow(signal: Array, serving: Ints, before: Array, u: int) -> None:
    """Write each user's strongest UAV into `serving` (K,) after row u of `signal` (U, K) changed from `before`."""
    for k in range(serving.shape[0]):
        v = serving[k]
        if v != u:
            if signal[u, k] > signal[v, k]:
                serving[k] = u
        elif signal[u, k] < before[k]:
            best = u
            for i in range(signal.shape[0]):
                if signal[i, k] > signal[best, k]:
                    best = i
            serving[k] = best


@kernel
def position(arena: Arena, u: int, x: float, y: float, n: int) -> tuple[float, float]:
    """Return where UAV u is in slot n on its straight flight to (x, y), and from there to its end in time.

    One whose path is pinned is where its path has it.
    """
    if arena.has_pinned and is_pinned(arena, u):
        return arena.pinned[n, 0, u], arena.pinned[n, 1, u]
    x0, y0, step, last = arena.start_m[0, u], arena.start_m[1, u], arena.step_m[u], arena.last[u]
    flown, way = min(n, last) * step, np.hypot(x - x0, y - y0)
    if arena.has_ends and not np.isnan(arena.end_m[0, u]):
        x1, y1 = arena.end_m[0, u], arena.end_m[1, u]
        left, back = max(last - n, 0) * step, np.hypot(x - x1, y - y1)
        if left < back:
            return x1 + (x - x1) * left / back, y1 + (y - y1) * left / back
    if flown >= way:
        return x, y
    return x0 + (x - x0) * flown / way, y0 + (y - y0) * flown / way


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
            total += np.log(max(shots.z[k], TINY) / (n_all + shots.fixed[k]))
        return float(total / arena.mu - penalty / n_all)
    for k in range(n_users):
        total += shots.z[k]
    return float(n_users * np.log(max(total, TINY) / (n_users * n_all)) / arena.mu - penalty / n_all)


@kernel
def _sum_worth(arena: Arena, shots: Snapshots) -> float:
    """Return the soft mean of the sum rates of the moments."""
    least, total, n_all, count = np.inf, 0.0, 0.0, shots.slot.shape[0]
    rates = np.empty(count)
    for m in range(count):
        rates[m] = _sum_rate(arena, shots, m)
        least = min(least, rates[m])
        n_all += shots.slots[m]
    for m in range(count):
        total += shots.slots[m] * (rates[m] if arena.mu == 0.0 else np.exp(arena.mu * (rates[m] - least)))
    return float(total / n_all if arena.mu == 0.0 else least + np.log(total / n_all) / arena.mu)


@kernel
def _sum_rate(arena: Arena, shots: Snapshots, m: int) -> float:
    """Give each band to the best of the users that its UAV serves, after the minimum rates."""
    signal, total, serving = shots.signal[m], shots.total[m], shots.serving[m]
    best, left, rate = shots.level, shots.left, 0.0
    for u in range(best.shape[0]):
        best[u], left[u] = 0.0, arena.khz[u]
    for k in range(serving.shape[0]):
        u = serving[k]
        own = signal[u, k]
        sinr = own / max(total[k] - own, 1.0)
        best[u] = max(best[u], sinr)
        if arena.has_minimum and arena.min_kbps[k] > 0.0:
            left[u] -= arena.min_kbps[k] / max(PER_LN * np.log(1.0 + sinr), 1e-12)
            rate += arena.min_kbps[k]
    for u in range(best.shape[0]):
        if left[u] < 0.0:
            rate -= UNMET * min(1.0 - left[u] / arena.khz[u], 1e6)
        elif best[u] > 0.0:
            rate += left[u] * PER_LN * np.log(1.0 + best[u])
    return float(rate)


@kernel
def _share_moment(arena: Arena, shots: Snapshots, m: int) -> float:
    """Share the bands of one moment for the minorant with `log_weight`, and add exp(mu rate) of each user to `z`.

    What comes back is the penalty for minimum rates that do not fit.
    """
    short = _demands(arena, shots, m)
    serving, slots = shots.serving[m], shots.slots[m]
    _levels(shots.inverse, shots.first, serving, shots.left, shots.width, shots.top, shots.level)
    first, level, z = shots.first, shots.level, shots.z
    for k in range(serving.shape[0]):
        above = first[k] - level[serving[k]]
        given = slots * np.exp(-above) if above > 0.0 else slots
        z[k] += given * np.exp(arena.mu * arena.min_kbps[k]) if arena.has_minimum else given
    return short


@kernel
def _demands(arena: Arena, shots: Snapshots, m: int) -> float:
    """Write what the next kHz is worth to each user and what each band has left; return the penalty."""
    signal, total, serving, left = shots.signal[m], shots.total[m], shots.serving[m], shots.left
    first, inverse, log_weight, decay_per_rate = shots.first, shots.inverse, shots.log_weight, -arena.mu
    for u in range(left.shape[0]):
        left[u] = arena.khz[u]
    for k in range(serving.shape[0]):
        own = signal[serving[k], k]
        others = max(total[k] - own, 1.0)
        eff = max(PER_LN * np.log((own + others) / others), 1e-12)
        decay = decay_per_rate * eff
        inverse[k] = 1.0 / decay
        first[k] = log_weight[k] + np.log(decay)
        if arena.has_minimum and arena.min_kbps[k] > 0.0:
            first[k] += arena.mu * arena.min_kbps[k]
            left[serving[k]] -= arena.min_kbps[k] / eff
    short = 0.0
    for u in range(left.shape[0]):
        if left[u] < 0.0:
            short += UNMET * min(1.0 - left[u] / arena.khz[u], 1e6)
            left[u] = 0.0
    return short


@kernel
def _levels(inverse: Array, first: Array, serving: Ints, left: Array, width: Array, top: Array, level: Array) -> None:
    """Log lambda of each UAV into `level` (U,): water-filling, users that would get less than nothing dropping out."""
    active = -1
    for u in range(level.shape[0]):
        level[u] = -np.inf
    while True:
        count = 0
        for u in range(level.shape[0]):
            width[u] = top[u] = 0.0
        for k in range(serving.shape[0]):
            u = serving[k]
            if first[k] > level[u]:
                width[u] += inverse[k]
                top[u] += first[k] * inverse[k]
                count += 1
        if count == active:
            return
        active = count
        for u in range(level.shape[0]):
            if width[u] > 0.0:
                level[u] = (top[u] - left[u]) / width[u]


@kernel
def keep(arena: Arena, shots: Snapshots) -> None:
    """Take the places as they are now for good: the next moves are judged by their marginal worth."""
    if arena.kind == PER_USER:
        for k in range(shots.z.shape[0]):
            shots.log_weight[k] = -np.log(max(shots.z[k], TINY))
