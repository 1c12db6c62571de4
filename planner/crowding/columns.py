"""Compiled kernels of the crowding bound: the field at the users, and what serving a user is worth in it.

Lengths are in units of the greatest altitude. K users, U UAVs in C classes that differ in nothing but where they can
be; T entries of the tables of `repulsion.Repulsion`, F far rings, R rings in all, L values of x.
"""

from __future__ import annotations

from math import log, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import entry, kernel, smooth

Ints: TypeAlias = NDArray[np.int64]
AT_ONCE = 16
"""Intervals of x that are looked at before it is asked whether the next ones can be better."""


class Medium(NamedTuple):
    """What columns are made of, whichever UAV serves a user.

    step, tables (3, T), low (F, T): kappa, its slope and its bend, and its least value within each far ring. rings:
    (R + 1,). share: (R,). levels: (L,), rising values of x from 1. logs: (Y, L), log(1 + e^y / x) on a grid of y from
    least_log on, whose chords lie above it. at_zero: kappa(0). value_error, slope_error: of a field and its slope.
    """

    step: float
    tables: Array
    low: Array
    rings: Array
    share: Array
    levels: Array
    logs: Array
    log_step: float
    least_log: float
    at_zero: float
    value_error: float
    slope_error: float


class Links(NamedTuple):
    """Who could serve whom, by class: (C, K) each, and height2 (C,).

    gain: own SNR gain. power: with what it interferes at least. scale: kbit/s per nat, weighted. least: the least x.
    """

    gain: Array
    power: Array
    scale: Array
    least: Array
    height2: Array


class Column(NamedTuple):
    """A user served from a ring: what does not depend on x.

    fainter, louder: weighted kbit/s for each nat of log(1 + S/x) at the grid's next lower and next higher S. power,
    share, at_zero, lowest: what the UAV interferes with at least, s of the ring, kappa(0), and the least of the field.
    repelled, strength: what the price of an interval is made of.
    """

    fainter: float
    louder: float
    repelled: float
    strength: float
    power: float
    share: float
    at_zero: float
    lowest: float


@entry
def spread(
    at: Array, users: Ints, weights: Array, points: Array, step: float, tables: Array, low: Array, field: Array
) -> None:
    """Add sources to the field at `points` (P, 2): sources of `weights` at `at[users]`.

    field: (4 + F, P), the field, its slope east and north, the bound of its bend, and its least value around each point
    within each far ring.
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
    medium: Medium, links: Links, field: Array, nearest: bool, worth: Array, feature: Array, bare: Array
) -> None:
    """Fill in what a UAV of each class that is at least in ring i from a user can be worth by serving it.

    field: as `spread` made it, at the users. nearest: only ring 0 of the result is wanted. worth: (C, K, R),
    weighted kbit/s; feature, bare: of the column that has it, and what it is worth without repulsion.
    """
    n_rings, value = len(medium.share), np.empty(AT_ONCE)
    for c in range(len(links.gain)):
        for k in range(links.gain.shape[1]):
            slope = sqrt(field[1, k] ** 2 + field[2, k] ** 2) + medium.slope_error
            first = _first_level(medium.levels, links.least[c, k])
            best, best_feature, best_bare = 0.0, 0.0, 0.0
            for step in range(n_rings):
                i = step if nearest else n_rings - 1 - step
                lowest = _lowest(medium, field, k, i, slope, medium.rings[i + 1])
                snr = links.gain[c, k] / (medium.rings[i] ** 2 + links.height2[c])
                won, f, alone, most = _best_column(
                    medium, first, snr, links.scale[c, k], links.power[c, k], medium.share[i], lowest, best, value
                )
                if won > best:
                    best, best_feature, best_bare = won, f, alone
                worth[c, k, i] = best
                feature[c, k, i] = best_feature
                bare[c, k, i] = best_bare
                if nearest and most <= best:
                    break  # what is farther away is worth less
            if nearest:
                worth[c, k, 0] = best
                feature[c, k, 0] = best_feature
                bare[c, k, 0] = best_bare


@entry
def worth_of_reaching(
    medium: Medium,
    links: Links,
    classes: Ints,
    least: Array,
    user: Array,
    disc: Array,
    field: Array,
    sources: Ints,
    weights: Array,
    candidates: Ints,
    worth: Array,
    feature: Array,
    bare: Array,
) -> None:
    """Lower the worth (U, K) of some pairs by where the UAV can be: near enough both to its start and to the user.

    disc: (U, 3), east, north, radius of where each UAV can be. least: (U, K). sources, weights: those of the field.
    candidates: (U, M), the users to look at. worth, feature, bare: (U, K), changed in place.
    """
    n_rings = len(medium.share)
    n_near = n_rings - len(medium.low)
    local, point, value = np.empty((4, 1)), np.empty((1, 2)), np.empty(AT_ONCE)
    for u in range(len(candidates)):
        c = classes[u]
        for m in range(candidates.shape[1]):
            k = candidates[u, m]
            east, north = disc[u, 0] - user[k, 0], disc[u, 1] - user[k, 1]
            away, reach = sqrt(east * east + north * north), disc[u, 2]
            slope = sqrt(field[1, k] ** 2 + field[2, k] ** 2) + medium.slope_error
            first = _first_level(medium.levels, least[u, k])
            best, best_feature, best_bare = 0.0, 0.0, 0.0
            for i in range(n_rings):
                inner, outer = max(medium.rings[i], away - reach), min(medium.rings[i + 1], away + reach)
                if outer < inner:
                    continue
                along, radius = _lens(away, reach, outer)
                lowest = _lowest(medium, field, k, i, slope, outer)
                if radius <= medium.rings[n_near]:
                    ahead = 0.5 * along / away if away > 0.0 else 0.0
                    point[0, 0], point[0, 1] = user[k, 0] + ahead * east, user[k, 1] + ahead * north
                    local[:] = 0.0
                    spread(user, sources, weights, point, medium.step, medium.tables, medium.low[:0], local)
                    there = sqrt(local[1, 0] ** 2 + local[2, 0] ** 2) + medium.slope_error
                    about = _sloping(local[0, 0], there, local[3, 0], radius / 2) - medium.value_error
                    lowest = max(lowest, about)
                snr = links.gain[c, k] / (inner**2 + links.height2[c])
                won, f, alone, most = _best_column(
                    medium, first, snr, links.scale[c, k], links.power[c, k], medium.share[i], lowest, best, value
                )
                if won > best:
                    best, best_feature, best_bare = won, f, alone
                if most <= best:
                    break
            if best < worth[u, k]:
                worth[u, k], feature[u, k], bare[u, k] = best, best_feature, best_bare


@kernel
def _lens(away: float, reach: float, outer: float) -> tuple[float, float]:
    """Return a disc about what is within `reach` of a point and within `outer` of a user that is `away` from it.

    How far from the user its centre lies towards the point, and its radius.
    """
    if away <= 0.0:
        return 0.0, min(reach, outer)
    along = (away * away + outer * outer - reach * reach) / (2.0 * away)
    if along <= 0.0:
        return 0.0, outer
    if along >= away:
        return away, reach
    return along, sqrt(max(0.0, outer * outer - along * along))


@kernel
def _lowest(medium: Medium, field: Array, k: int, ring: int, slope: float, outer: float) -> float:
    """Return the least that a field can be midway between user k and a UAV in the ring, not farther than `outer`."""
    n_near = len(medium.share) - len(medium.low)
    if ring >= n_near:
        return float(field[4 + ring - n_near, k])
    return _sloping(field[0, k], slope, field[3, k], outer / 2) - medium.value_error


@kernel
def _sloping(value: float, slope: float, bend: float, radius: float) -> float:
    """Return the least a field can be within a radius of where its value and slope are known."""
    return value - slope * radius - 0.5 * bend * radius * radius


@kernel
def _first_level(levels: Array, least: float) -> int:
    """Return the interval of x that holds the least one."""
    return max(0, int(np.searchsorted(levels, least)) - 1)


@kernel
def _best_column(
    medium: Medium,
    first: int,
    snr: float,
    scale: float,
    power: float,
    share: float,
    lowest: float,
    before: float,
    value: Array,
) -> tuple[float, float, float, float]:
    """Return the greatest worth over the intervals of x if it is more than `before`, and what belongs to it.

    That is its feature, what it is worth without repulsion, and the rate at the least x. value: (AT_ONCE,), scratch.

    Each interval gets the price b that makes its worth least.
    """
    levels, logs = medium.levels, medium.logs
    place = max(0.0, (log(snr) - medium.least_log) / medium.log_step) if snr > 0.0 else 0.0
    n = min(int(place), len(logs) - 2)
    column = Column(
        fainter=scale * (1.0 - (place - n)),
        louder=scale * (place - n),
        repelled=power * share * share * medium.at_zero - 1.0,
        strength=share * max(lowest, 0.0),
        power=power,
        share=share,
        at_zero=medium.at_zero,
        lowest=lowest,
    )
    low, high = logs[n], logs[n + 1]
    most, best, at = column.fainter * low[first] + column.louder * high[first], before, -1
    for begin in range(first, len(levels) - 1, AT_ONCE):
        if column.fainter * low[begin] + column.louder * high[begin] <= best:
            break
        end = min(begin + AT_ONCE, len(levels) - 1)
        won = _worth_of_intervals(column, levels, low, high, begin, end, value)
        if won > best:
            best, at = won, begin + _where(value, won)
    if at < 0:
        return best, 0.0, 0.0, most
    rate = column.fainter * low[at] + column.louder * high[at]
    after = column.fainter * low[at + 1] + column.louder * high[at + 1]
    pull = column.strength / (levels[at + 1] + column.repelled)
    price, feature = 0.5 * power * pull * pull, share * power * pull
    bare = max(rate + price * levels[at], after + price * levels[at + 1]) - price
    if bare + 0.5 * feature * feature * medium.at_zero - feature * lowest > rate:
        return best, 0.0, rate, most
    return best, feature, bare, most


@smooth
def _worth_of_intervals(
    column: Column, levels: Array, low: Array, high: Array, begin: int, end: int, value: Array
) -> float:
    """Write what the intervals [begin, end) of x are worth at most into `value`, and return the greatest."""
    fainter, louder, repelled, strength = column.fainter, column.louder, column.repelled, column.strength
    half_power, of_pull = 0.5 * column.power, column.share * column.power
    half_zero, lowest, best = 0.5 * column.at_zero, column.lowest, -1.0
    for i in range(end - begin):
        x = begin + i
        at_low, at_high = fainter * low[x] + louder * high[x], fainter * low[x + 1] + louder * high[x + 1]
        pull = strength / (levels[x + 1] + repelled)
        price, feature = half_power * pull * pull, of_pull * pull
        bare = max(at_low + price * levels[x], at_high + price * levels[x + 1]) - price
        value[i] = min(at_low, bare + feature * (half_zero * feature - lowest))
        best = max(best, value[i])
    return best


@kernel
def _where(value: Array, wanted: float) -> int:
    """Return the place of a number that is there."""
    i = 0
    while i < len(value) - 1 and value[i] != wanted:
        i += 1
    return i
