"""Where all are in a few moments of the straight flights to a set of hover points, and what users receive then.

Which points are good is asked thousands of times, so it is answered without paths: everyone flies straight to its
point, hovers, and flies to its end in time; a handful of moments stand for the slots around them. In each moment a user
belongs to the UAV with the strongest signal. Moving one UAV changes one row of the signals, so that asking again takes
K steps a moment and not U K. What the moments are worth is in `appraisal.py`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import PER_USER, Arena, Ints, inlined, is_pinned, kernel, smooth
from skyfolio.planner.fast.bent import hear_bent, hear_map
from skyfolio.planner.fast.routes import reach_of_step

STRETCHES = (0.35, 0.8, 1.5, 3.0, 6.0)
"""Where the stretches that a moment stands for end, in flights to a neighbour; the last one ends with the plan."""


class Heard(NamedTuple):
    """What users receive at M moments. total: (M, K), 1 + the SNR from all UAVs; own: (M, K), from the strongest one.

    serving: (M, K), which one that is.
    """

    total: Array
    own: Array
    serving: Ints


class Snapshots(NamedTuple):
    """The fleet at M moments, everyone bound for `place` (2, U). Bands are kHz and rates kbit/s, as in the arena.

    slot: (M,), the slots looked at; slots: (M,), how many each stands for. gain: (M, U, 1) m^2, or (M, U, K) of a
    sampled channel. signal: (M, U, K) SNR. kept: what is heard without the move that is on trial; heard: with it.
    kept_signal, kept_place: what a trial of up to two UAVs overwrites, to take it back.
    fixed: (K,), sum exp(mu rate) of each user over what no place changes; z: (K,), the same over everything.
    log_weight: (K,), of the minorant by which bands are shared (`shares.py`). level: (M, U), log lambda of each UAV.
    inverse, first: (K,), and width, top, left: (U,), scratch of one moment.
    """

    slot: Ints
    slots: Array
    gain: Array
    place: Array
    signal: Array
    kept: Heard
    heard: Heard
    kept_signal: Array
    kept_place: Array
    fixed: Array
    z: Array
    log_weight: Array
    level: Array
    inverse: Array
    first: Array
    width: Array
    top: Array
    left: Array


def snapshots_of(arena: Arena) -> Snapshots:
    """Empty tables of the right size, for the moments that count in `arena`."""
    edges = _edges(arena)
    slot = (edges[:-1] + edges[1:] - 1) // 2
    count, n_uavs, n_users = len(slot), arena.gain.shape[1], arena.user_m.shape[2]
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
        kept=_heard_of(count, n_users),
        heard=_heard_of(count, n_users),
        kept_signal=np.zeros((2, count, n_users)),
        kept_place=np.zeros((2, n_uavs)),
        fixed=fixed,
        z=np.ones(n_users),
        log_weight=np.zeros(n_users),
        level=np.full((count, n_uavs), -np.inf),
        inverse=np.zeros(n_users),
        first=np.zeros(n_users),
        width=np.zeros(n_uavs),
        top=np.zeros(n_uavs),
        left=np.zeros(n_uavs),
    )


def _heard_of(count: int, n_users: int) -> Heard:
    shape = (count, n_users)
    return Heard(np.ones(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64))


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
    """Return what each moment's signals are computed from; sampled gains are averaged over the stretch.

    So is whether users are there.
    """
    if arena.fading.shape[0] == 0 and not arena.has_absent:
        return np.ascontiguousarray(arena.gain[slot][:, :, None])
    fading = arena.fading if arena.fading.shape[0] else arena.gain[:, :, None]
    if arena.has_absent:
        fading = fading * (arena.absent == 0)[:, None, :]
    means = [fading[begin:end].mean(axis=0) for begin, end in pairwise(edges)]
    return np.ascontiguousarray(np.stack(means))


@kernel
def gather(arena: Arena, shots: Snapshots, place_m: Array) -> None:
    """Send everyone to `place_m` (2, U), metres, on trial."""
    shots.place[:] = place_m
    total, own, serving = shots.heard
    total[:], own[:], serving[:] = 1.0, 0.0, 0
    plain, start_m, last, step_m = _fly_plainly(arena), arena.start_m, arena.last, arena.step_m
    user_m, per_slot, height2, bent = arena.user_m, arena.per_slot, arena.height2, arena.has_bend
    table, rows, per_metre = arena.bend.factor, arena.bend.row, arena.bend.per_metre
    mapped = arena.bend.logs.shape[0] > 0
    for m in range(shots.slot.shape[0]):
        for u in range(place_m.shape[1]):
            x, y, n = place_m[0, u], place_m[1, u], shots.slot[m]
            if plain:
                x, y = _after(start_m[0, u], start_m[1, u], x, y, min(n, last[u]) * step_m[u])
            else:
                x, y = position(arena, u, x, y, n)
            row = shots.signal[m, u]
            if bent:
                which = rows[u]
                hear_bent(user_m[n * per_slot], shots.gain[m, u], x, y, height2[u], table, per_metre[which], which, row)
                if mapped:
                    hear_map(arena.bend, n * per_slot, x, y, which, row)
            else:
                _hear(user_m[n * per_slot], shots.gain[m, u], x, y, height2[u], row)
            _add(row, u, total[m], own[m], serving[m])


@smooth
def _hear(user_m: Array, gain: Array, x: float, y: float, height2: float, row: Array) -> None:
    """Write the SNR of a UAV at (x, y) at every user into `row` (K,)."""
    east, north, spread, shared, same = user_m[0], user_m[1], user_m[2], gain.shape[0] == 1, gain[0]
    for k in range(row.shape[0]):
        de, dn = x - east[k], y - north[k]
        row[k] = (same if shared else gain[k]) / (de * de + dn * dn + (height2 + spread[k]))


@smooth
def _add(row: Array, u: int, total: Array, own: Array, serving: Ints) -> None:
    for k in range(row.shape[0]):
        total[k] += row[k]
        louder = row[k] > own[k]
        serving[k] = u if louder else serving[k]
        own[k] = row[k] if louder else own[k]


@kernel
def aim(arena: Arena, shots: Snapshots, u: int, x: float, y: float, second: bool) -> None:
    """Send UAV u to (x, y) metres instead, in every snapshot, on trial; `second`: beside another move."""
    if not second:
        shots.kept_place[:] = shots.place
    shots.place[0, u], shots.place[1, u] = x, y
    old_total, old_own, old_serving = shots.heard if second else shots.kept
    total, own, serving = shots.heard
    plain, x0, y0 = _fly_plainly(arena), arena.start_m[0, u], arena.start_m[1, u]
    last, step_m = arena.last[u], arena.step_m[u]
    user_m, per_slot, height2, bent = arena.user_m, arena.per_slot, arena.height2[u], arena.has_bend
    table, rows, per_metre = arena.bend.factor, arena.bend.row, arena.bend.per_metre
    mapped = arena.bend.logs.shape[0] > 0
    for m in range(shots.slot.shape[0]):
        n = shots.slot[m]
        px, py = _after(x0, y0, x, y, min(n, last) * step_m) if plain else position(arena, u, x, y, n)
        signal, before = shots.signal[m], shots.kept_signal[int(second), m]
        before[:] = signal[u]
        if bent:
            which, row = rows[u], signal[u]
            hear_bent(user_m[n * per_slot], shots.gain[m, u], px, py, height2, table, per_metre[which], which, row)
            if mapped:
                hear_map(arena.bend, n * per_slot, px, py, which, row)
        else:
            _hear(user_m[n * per_slot], shots.gain[m, u], px, py, height2, signal[u])
        _exchange(old_total[m], before, signal[u], total[m])
        _follow(signal, old_own[m], old_serving[m], before, u, own[m], serving[m])


@smooth
def _exchange(old_total: Array, before: Array, now: Array, total: Array) -> None:
    for k in range(total.shape[0]):
        total[k] = old_total[k] + (now[k] - before[k])


@kernel
def _follow(signal: Array, old_own: Array, old_serving: Ints, before: Array, u: int, own: Array, serving: Ints) -> None:
    """Write each user's strongest UAV and its signal, after row u of `signal` (U, K) has changed from `before`."""
    now = signal[u]
    for k in range(serving.shape[0]):
        best, loudest = old_serving[k], old_own[k]
        if best != u:
            if now[k] > loudest:
                best, loudest = u, now[k]
        else:
            loudest = now[k]
            for i in range(signal.shape[0] if now[k] < before[k] else 0):
                if signal[i, k] > loudest:
                    best, loudest = i, signal[i, k]
        own[k], serving[k] = loudest, best


@kernel
def keep(shots: Snapshots) -> None:
    """Take what is on trial for good."""
    for old, new in ((shots.kept.total, shots.heard.total), (shots.kept.own, shots.heard.own)):
        old[:] = new
    shots.kept.serving[:] = shots.heard.serving


@kernel
def take_back(shots: Snapshots, u: int, other: int) -> None:
    """Undo the trial in which u moved, and then `other` if that is not -1."""
    shots.place[:] = shots.kept_place
    for m in range(shots.slot.shape[0]):
        shots.signal[m, u] = shots.kept_signal[0, m]
        if other >= 0:
            shots.signal[m, other] = shots.kept_signal[1, m]


@kernel
def position(arena: Arena, u: int, x: float, y: float, n: int) -> tuple[float, float]:
    """Return where UAV u is in slot n on its straight flight to (x, y), and from there to its end in time.

    One whose path is pinned is where its path has it.
    """
    if arena.has_pinned and is_pinned(arena, u):
        return arena.pinned[n, 0, u], arena.pinned[n, 1, u]
    x0, y0, last = arena.start_m[0, u], arena.start_m[1, u], arena.last[u]
    flown = min(n, last) * reach_of_step(arena, u, x - x0, y - y0)
    if arena.has_ends and not np.isnan(arena.end_m[0, u]):
        x1, y1 = arena.end_m[0, u], arena.end_m[1, u]
        left, back = max(last - n, 0) * reach_of_step(arena, u, x1 - x, y1 - y), np.hypot(x - x1, y - y1)
        if left < back:
            return x1 + (x - x1) * left / back, y1 + (y - y1) * left / back
    return _after(x0, y0, x, y, flown)


@kernel
def _fly_plainly(arena: Arena) -> bool:
    """Return whether all UAVs fly straight to their places and stay: then nothing of the arena need be handed on."""
    return not (arena.has_pinned or arena.has_ends or arena.has_wind)


@inlined
def _after(x0: float, y0: float, x: float, y: float, flown: float) -> tuple[float, float]:
    """Return where a UAV is after `flown` metres from (x0, y0) towards (x, y), where it stays."""
    way = np.hypot(x - x0, y - y0)
    if flown >= way:
        return x, y
    return x0 + (x - x0) * flown / way, y0 + (y - y0) * flown / way
