"""Channels whose gain is not an inverse square: a factor of it, tabulated over the distance over ground.

A map of gains (`channels.gain_map`) is one more factor, tabulated over the places of a UAV for each receiver.

Everything that needs a signal needs two numbers of a link: the factor at its distance, and how it changes there. With
`near` the slope of -log(signal) in the squared distance, which is 1/d^2 for the letter's channel, gradients are the
same as for that one (`links_narrow.py`).
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.elementary import exp
from skyfolio.planner.fast.jit import inlined, smooth

Ints = NDArray[np.int64]
LEAST_M = 1e-6
"""Distances over ground are taken to be no less where something is divided by them."""


class Bend(NamedTuple):
    """The factors of `channels.bends.Bends`, as kernels take them; `factor` is empty for an inverse square.

    factor: (R, T), of R different profiles, at distances over ground that are a step apart. row: (U,), which profile
    each UAV has. per_metre: (R,), steps per metre. like, like_height2: (U,), factor and squared height of an inverse
    square that is somewhat like it, for guesses. logs: (R, Y, X, M), the logarithms of another factor at places of the
    UAV on a grid, for each of M receivers, empty without one; reads: (S, K), which of them each user has, S as in
    `Arena.user_m`. west_south: (2,), the first place, metres; per_cell: places per metre.
    """

    factor: Array
    row: Ints
    per_metre: Array
    like: Array
    like_height2: Array
    logs: Array
    reads: Ints
    west_south: Array
    per_cell: float


@inlined
def bent(factor: Array, which: int, per_metre: float, over2: float) -> tuple[float, float]:
    """Return the factor at a squared distance over ground, and its slope in that: m^2 and 1/m^2.

    factor: (R, T), of which row `which` counts. Between its entries it is linear in the distance, beyond the last one
    it stays as it is.
    """
    away = sqrt(over2)
    place = away * per_metre
    at = int(min(place, factor.shape[1] - 2.0))
    part = place - at
    rise = factor[which, at + 1] - factor[which, at]
    slope = rise * per_metre * 0.5 / max(away, LEAST_M) if part <= 1.0 else 0.0
    return factor[which, at] + min(part, 1.0) * rise, slope


@inlined
def cell_of(place: float, count: int) -> tuple[int, float, float]:
    """Return in which of the cells between `count` places one is, how far in, 0 to 1, and 1 on the grid, 0 beyond."""
    inside = 1.0 if 0.0 <= place <= count - 1.0 else 0.0
    place = min(max(place, 0.0), count - 1.0)
    cell = int(min(place, count - 2.0))
    return cell, place - cell, inside


@smooth
def map_signals(path: Array, bend: Bend, at: int, n: int, k: int, signal: Array, lean: Array) -> None:
    """Multiply SNRs (U,) at user k by what its map says, and write the slopes of its logarithm into `lean` (2, U)."""
    logs, row, per_cell, reader = bend.logs, bend.row, bend.per_cell, bend.reads[at, k]
    west, south = bend.west_south[0], bend.west_south[1]
    for i in range(signal.shape[0]):
        x, over_x, on_x = cell_of((path[n, 0, i] - west) * per_cell, logs.shape[2])
        y, over_y, on_y = cell_of((path[n, 1, i] - south) * per_cell, logs.shape[1])
        which = row[i]
        a, b = logs[which, y, x, reader], logs[which, y, x + 1, reader]
        c, d = logs[which, y + 1, x, reader], logs[which, y + 1, x + 1, reader]
        lower, upper = a + over_x * (b - a), c + over_x * (d - c)
        lean[0, i] = on_x * per_cell * ((1.0 - over_y) * (b - a) + over_y * (d - c))
        lean[1, i] = on_y * per_cell * (upper - lower)
        signal[i] *= exp(lower + over_y * (upper - lower))


@smooth
def hear_map(bend: Bend, at: int, x_m: float, y_m: float, which: int, row: Array) -> None:
    """Multiply the SNRs (K,) of a UAV at (x_m, y_m) by what the maps say."""
    logs, reads = bend.logs[which], bend.reads[at]
    x, over_x, _ = cell_of((x_m - bend.west_south[0]) * bend.per_cell, logs.shape[1])
    y, over_y, _ = cell_of((y_m - bend.west_south[1]) * bend.per_cell, logs.shape[0])
    south_west, south_east, north_west, north_east = logs[y, x], logs[y, x + 1], logs[y + 1, x], logs[y + 1, x + 1]
    for k in range(row.shape[0]):
        m = reads[k]
        lower = south_west[m] + over_x * (south_east[m] - south_west[m])
        upper = north_west[m] + over_x * (north_east[m] - north_west[m])
        row[k] *= exp(lower + over_y * (upper - lower))


@smooth
def map_at(bend: Bend, which: int, reader: int, x_m: float, y_m: float) -> float:
    """Return the factor of the map of one receiver for a UAV at (x_m, y_m)."""
    logs = bend.logs
    x, over_x, _ = cell_of((x_m - bend.west_south[0]) * bend.per_cell, logs.shape[2])
    y, over_y, _ = cell_of((y_m - bend.west_south[1]) * bend.per_cell, logs.shape[1])
    a, b = logs[which, y, x, reader], logs[which, y, x + 1, reader]
    c, d = logs[which, y + 1, x, reader], logs[which, y + 1, x + 1, reader]
    lower, upper = a + over_x * (b - a), c + over_x * (d - c)
    return exp(lower + over_y * (upper - lower))


@smooth
def lean_link(
    slope: Array, n: int, u: int, scale: float, own: float, others: float, lean: Array, signal: Array
) -> None:
    """Add what a map adds to the slope of one link: all signals but that of its UAV u, which is `own`, interfere."""
    push = scale * own / ((own + others) * others)
    for i in range(signal.shape[0]):
        slope[n, 0, i] -= push * signal[i] * lean[0, i]
        slope[n, 1, i] -= push * signal[i] * lean[1, i]
    pull = scale * own / (own + others)
    slope[n, 0, u] += pull * lean[0, u]
    slope[n, 1, u] += pull * lean[1, u]


@smooth
def lean_draws(
    slope: Array, n: int, u: int, scale: float, draws: Array, own: Array, others: Array, lean: Array, signal: Array
) -> None:
    """Add the same to the slope of one link's mean rate over draws (U, S); own, others: (S,)."""
    n_draws = own.shape[0]
    for i in range(signal.shape[0]):
        worth = 0.0
        for s in range(n_draws):
            if i == u:
                worth += own[s] / (own[s] + others[s])
            else:
                worth -= signal[i] * draws[i, s] * own[s] / ((own[s] + others[s]) * others[s])
        slope[n, 0, i] += scale * worth / n_draws * lean[0, i]
        slope[n, 1, i] += scale * worth / n_draws * lean[1, i]


@smooth
def bent_signals(
    path: Array,
    gain: Array,
    fading: Array,
    height2: Array,
    table: Array,
    row: Ints,
    per_metre: Array,
    east: float,
    north: float,
    spread: float,
    n: int,
    k: int,
    near: Array,
    signal: Array,
) -> None:
    """SNR of every UAV at user k, who is at (east, north) in slot n, into `signal`, and its slope into `near`: (U,).

    table, row, per_metre: of `Bend`, here and below.
    """
    sampled = fading.shape[0] > 0
    for i in range(near.shape[0]):
        de, dn = path[n, 0, i] - east, path[n, 1, i] - north
        over2 = de * de + dn * dn + spread
        factor, slope = bent(table, row[i], per_metre[row[i]], over2)
        inverse = 1.0 / (over2 + height2[i])
        near[i] = inverse - slope / factor
        signal[i] = (fading[n, i, k] if sampled else gain[n, i]) * factor * inverse


@smooth
def hear_bent(
    user_m: Array,
    gain: Array,
    x: float,
    y: float,
    height2: float,
    table: Array,
    per_metre: float,
    which: int,
    row: Array,
) -> None:
    """Write the SNR of a UAV at (x, y) at every user into `row` (K,). gain: (1,) or (K,); which: of the profiles."""
    east, north, spread, shared, same = user_m[0], user_m[1], user_m[2], gain.shape[0] == 1, gain[0]
    for k in range(row.shape[0]):
        de, dn = x - east[k], y - north[k]
        over2 = de * de + dn * dn + spread[k]
        row[k] = (same if shared else gain[k]) * bent(table, which, per_metre, over2)[0] / (over2 + height2)
