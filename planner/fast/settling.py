"""Where to hover: a local search over hover points for the utility itself, judged by `appraisal`.

One UAV at a time moves a little, to a user near by, or anywhere; two change places; whatever is worth more is kept.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.appraisal import weigh, worth
from skyfolio.planner.fast.arena import Arena, entry, is_pinned, kernel
from skyfolio.planner.fast.routes import reach_of_step
from skyfolio.planner.fast.snapshots import Snapshots, aim, gather, keep, take_back
from skyfolio.planner.fast.zones import holds

ALITTLE, NEARBY, ANY_USER, EXCHANGE = 0.4, 0.75, 0.85, 0.95
"""Shares of the moves, added up; the rest goes anywhere in the area."""
GAIN = 1e-9
"""Relative: less is rounding."""


@entry
def settle(arena: Arena, shots: Snapshots, sites_m: Array, draws: Array, value: float, heat: float) -> float:
    """Improve the places in `shots`, worth `value`, by one try for each row of `draws`; what they are worth then.

    sites_m: (2, S), points over users; draws: (tries, 6), uniform in (0, 1). heat: by how many kbit/s a move may now
    and then make things worse; the best places seen are what stays.
    """
    n_uavs = shots.place.shape[1]
    best, best_m = value, shots.place.copy()
    for i in range(draws.shape[0]):
        draw = draws[i]
        u, other, x, y = i % n_uavs, -1, 0.0, 0.0
        if draw[0] < ANY_USER or draw[0] >= EXCHANGE or n_uavs == 1:
            x, y = _new_place(arena, shots, sites_m, u, draw)
        else:
            other = int(draw[1] * n_uavs)
            x, y = shots.place[0, other], shots.place[1, other]
        if other == u or not _allowed(arena, shots, u, other, x, y):
            continue
        if other >= 0 and not _within_reach(arena, other, shots.place[0, u], shots.place[1, u]):
            continue
        was_x, was_y = shots.place[0, u], shots.place[1, u]
        aim(arena, shots, u, x, y, False)
        if other >= 0:
            aim(arena, shots, other, was_x, was_y, True)
        reached = worth(arena, shots)
        if reached > value + GAIN * abs(value) + heat * np.log(draw[5]):
            value = reached
            keep(shots)
            weigh(arena, shots)
            if value > best:
                best = value
                best_m[:] = shots.place
        else:
            take_back(shots, u, other)
    if best > value:
        gather(arena, shots, best_m)
        worth(arena, shots)
        keep(shots)
        weigh(arena, shots)
    return best


@kernel
def _new_place(arena: Arena, shots: Snapshots, sites_m: Array, u: int, draw: Array) -> tuple[float, float]:
    """Return where UAV u might hover instead, inside the area."""
    x, y = shots.place[0, u], shots.place[1, u]
    if draw[0] < ALITTLE:
        length, angle = 2.0 * draw[1] * draw[2] * np.sqrt(arena.height2[u]), 2.0 * np.pi * draw[3]
        x, y = x + length * np.cos(angle), y + length * np.sin(angle)
    elif draw[0] < ANY_USER:
        tries = 4 if draw[0] < NEARBY else 1
        least = np.inf
        for t in range(tries):
            s = int(draw[1 + t] * sites_m.shape[1])
            away = (sites_m[0, s] - x) ** 2 + (sites_m[1, s] - y) ** 2
            if 0.0 < away < least:
                least, nearest = away, s
        if least < np.inf:
            x, y = sites_m[0, nearest], sites_m[1, nearest]
    else:
        x = arena.low[0] + draw[1] * (arena.high[0] - arena.low[0])
        y = arena.low[1] + draw[2] * (arena.high[1] - arena.low[1])
    return min(max(x, arena.low[0]), arena.high[0]), min(max(y, arena.low[1]), arena.high[1])


@kernel
def _allowed(arena: Arena, shots: Snapshots, u: int, other: int, x: float, y: float) -> bool:
    """Return whether u may hover at (x, y): free, out of zones, within reach, and apart from everybody but `other`."""
    if (arena.has_pinned and is_pinned(arena, u)) or (other >= 0 and (arena.has_pinned and is_pinned(arena, other))):
        return False
    for d in range(arena.discs.shape[0]):
        if (x - arena.discs[d, 0]) ** 2 + (y - arena.discs[d, 1]) ** 2 < arena.discs[d, 2] ** 2:
            return False
    for p in range(arena.first.shape[0] - 1):
        if holds(arena.corners[arena.first[p] : arena.first[p + 1]], x, y):
            return False
    for v in range(shots.place.shape[1]):
        if v not in (u, other) and not (arena.has_pinned and is_pinned(arena, v)):
            de, dn = shots.place[0, v] - x, shots.place[1, v] - y
            if de * de + dn * dn < arena.separation_m * arena.separation_m:
                return False
    return _within_reach(arena, u, x, y)


@kernel
def _within_reach(arena: Arena, u: int, x: float, y: float) -> bool:
    """Return whether u can be at (x, y), flying straight, and still be at its end in time."""
    if not arena.has_ends or np.isnan(arena.end_m[0, u]):
        return True
    out_x, out_y = x - arena.start_m[0, u], y - arena.start_m[1, u]
    on_x, on_y = arena.end_m[0, u] - x, arena.end_m[1, u] - y
    there, back = np.hypot(out_x, out_y), np.hypot(on_x, on_y)
    if not arena.has_wind:
        return bool(there + back <= arena.last[u] * arena.step_m[u])
    out, on = reach_of_step(arena, u, out_x, out_y), reach_of_step(arena, u, on_x, on_y)
    return bool(out > 0.0 and on > 0.0 and there / out + back / on <= arena.last[u])
