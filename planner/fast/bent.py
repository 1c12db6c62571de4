"""Channels whose gain is not an inverse square: a factor of it, tabulated over the distance over ground.

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
from skyfolio.planner.fast.jit import inlined, smooth

Ints = NDArray[np.int64]
LEAST_M = 1e-6
"""Distances over ground are taken to be no less where something is divided by them."""


class Bend(NamedTuple):
    """The factors of `channels.bends.Bends`, as kernels take them; `factor` is empty for an inverse square.

    factor: (R, T), of R different profiles, at distances over ground that are a step apart. row: (U,), which profile
    each UAV has. per_metre: (R,), steps per metre. like, like_height2: (U,), factor and squared height of an inverse
    square that is somewhat like it, for guesses.
    """

    factor: Array
    row: Ints
    per_metre: Array
    like: Array
    like_height2: Array


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


@smooth
def bent_signals(
    path: Array,
    gain: Array,
    fading: Array,
    height2: Array,
    bend: Bend,
    east: float,
    north: float,
    spread: float,
    n: int,
    k: int,
    near: Array,
    signal: Array,
) -> None:
    """SNR of every UAV at user k, who is at (east, north) in slot n, into `signal`, and its slope into `near`: (U,)."""
    sampled, table, row, per_metre = fading.shape[0] > 0, bend.factor, bend.row, bend.per_metre
    for i in range(near.shape[0]):
        de, dn = path[n, 0, i] - east, path[n, 1, i] - north
        over2 = de * de + dn * dn + spread
        factor, slope = bent(table, row[i], per_metre[row[i]], over2)
        inverse = 1.0 / (over2 + height2[i])
        near[i] = inverse - slope / factor
        signal[i] = (fading[n, i, k] if sampled else gain[n, i]) * factor * inverse


@smooth
def hear_bent(
    user_m: Array, gain: Array, x: float, y: float, height2: float, bend: Bend, which: int, row: Array
) -> None:
    """Write the SNR of a UAV at (x, y) at every user into `row` (K,). gain: (1,) or (K,); which: of the profiles."""
    east, north, spread, shared, same = user_m[0], user_m[1], user_m[2], gain.shape[0] == 1, gain[0]
    factor, per_metre = bend.factor, bend.per_metre[which]
    for k in range(row.shape[0]):
        de, dn = x - east[k], y - north[k]
        over2 = de * de + dn * dn + spread[k]
        row[k] = (same if shared else gain[k]) * bent(factor, which, per_metre, over2)[0] / (over2 + height2)
