"""Compiled kernels of the crowding bound: the field at the users, and what serving a user is worth in it.

Lengths are in units of the greatest altitude. K users; T entries of the tables of `repulsion.Repulsion`; F far rings,
R rings in all; C classes of UAVs that differ in nothing but where they can be.
"""

from __future__ import annotations

from math import log, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import entry

Ints: TypeAlias = NDArray[np.int64]


@entry
def spread(
    at: Array, users: Ints, weights: Array, points: Array, step: float, tables: Array, low: Array, field: Array
) -> None:
    """Add sources to the field at `points` (P, 2): sources of `weights` at `at[users]`.

    tables: (3, T), kappa, its slope and its bend. field: (4 + F, P), the field, its slope east and north, the bound of
    its bend, and its least value around each point within each far ring.
    """
    for j in range(len(users)):
        weight = weights[j]
        for i in range(len(points)):
            east, north = points[i, 0] - at[users[j], 0], points[i, 1] - at[users[j], 1]
            away = sqrt(east * east + north * north)
            place = away / step
            n = int(place)
            part = place - n
            field[0, i] += weight * ((1.0 - part) * tables[0, n] + part * tables[0, n + 1])
            if away > 0.0:
                slope = weight * ((1.0 - part) * tables[1, n] + part * tables[1, n + 1]) / away
                field[1, i] += slope * east
                field[2, i] += slope * north
            field[3, i] += weight * max(tables[2, n], tables[2, n + 1])
            for ring in range(len(low)):
                field[4 + ring, i] += weight * min(low[ring, n], low[ring, n + 1])


@entry
def worth_of_serving(
    field: Array,
    value_error: float,
    slope_error: float,
    at_zero: float,
    rings: Array,
    share: Array,
    gain: Array,
    height2: Array,
    power: Array,
    scale: Array,
    least: Array,
    levels: Array,
    logs: Array,
    log_step: float,
    least_log: float,
    nearest: bool,
    worth: Array,
    feature: Array,
) -> None:
    """Fill in what a UAV of each class that is at least in ring i from a user can be worth by serving it.

    field: as `spread` made it, at the users. gain, power, scale, least: (C, K), own SNR gain, what it interferes with
    at least, kbit/s per nat (weighted), least x at the user. nearest: only ring 0 of the result is wanted. height2: (C,). levels: (L,), rising values of x from 1.
    logs: (Y, L), log(1 + e^y / x) on a grid of y, whose chords lie above it. worth, feature: (C, K, R).
    """
    n_rings = len(rings) - 1
    n_near = n_rings - (len(field) - 4)
    n_levels = len(levels) - 1
    n_grid = len(logs) - 2
    for c in range(len(gain)):
        for k in range(gain.shape[1]):
            slope = sqrt(field[1, k] ** 2 + field[2, k] ** 2) + slope_error
            first = max(0, np.searchsorted(levels, least[c, k]) - 1)
            best, best_feature = 0.0, 0.0
            for step in range(n_rings):
                i = step if nearest else n_rings - 1 - step
                r = rings[i + 1]
                if i < n_near:
                    lowest = field[0, k] - 0.5 * slope * r - 0.125 * field[3, k] * r * r - value_error
                else:
                    lowest = field[4 + i - n_near, k]
                snr = gain[c, k] / (rings[i] ** 2 + height2[c])
                place = max(0.0, (log(snr) - least_log) / log_step) if snr > 0.0 else 0.0
                n = min(int(place), n_grid)
                part = place - n
                upper = scale[c, k] * ((1.0 - part) * logs[n, first] + part * logs[n + 1, first])
                if nearest and upper <= best:
                    break  # what is farther away is worth less
                repelled = power[c, k] * share[i] ** 2 * at_zero - 1.0
                strength = share[i] * max(lowest, 0.0)
                for x in range(first, n_levels):
                    at_low = upper
                    if at_low <= best:
                        break
                    upper = scale[c, k] * ((1.0 - part) * logs[n, x + 1] + part * logs[n + 1, x + 1])
                    pull = strength / (levels[x + 1] + repelled)
                    price = 0.5 * power[c, k] * pull * pull
                    f = share[i] * power[c, k] * pull
                    a = max(at_low + price * levels[x], upper + price * levels[x + 1])
                    value = a - price + 0.5 * f * f * at_zero - f * lowest
                    if value > at_low:
                        value, f = at_low, 0.0
                    if value > best:
                        best, best_feature = value, f
                worth[c, k, i] = best
                feature[c, k, i] = best_feature
            if nearest:
                worth[c, k, 0] = best
                feature[c, k, 0] = best_feature
