"""Compiled kernels of the crowding bound: the field at the users, and what serving a user is worth in it.

Lengths are in units of the greatest altitude. K users; T entries of the tables of `repulsion.Repulsion`, R rings, L
values of y; M rows of links, each of which stands for UAVs that are alike.
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
"""Intervals of y that are looked at before it is asked whether the next ones can be better."""


class Medium(NamedTuple):
    """What columns are made of, whichever UAV serves a user.

    room: (R,), see `repulsion.Repulsion`. levels: (L,), rising values of y from 1. logs: (Y, L), log(1 + e^s / y) on a
    grid of s from least_log on, whose chords lie above it. at_zero: kappa(0). value_error: of a field.
    """

    room: Array
    levels: Array
    logs: Array
    log_step: float
    least_log: float
    at_zero: float
    value_error: float


class Links(NamedTuple):
    """Who could serve whom: (M, K) each.

    snr: S, from the nearest that the UAV can come to; 0 where none is needed. power: with what it interferes at least.
    scale: kbit/s per nat, weighted. least: the least y. ring: in which, or beyond which, the UAV must be.
    """

    snr: Array
    power: Array
    scale: Array
    least: Array
    ring: Ints


class Column(NamedTuple):
    """A user who is served by somebody: what does not depend on y.

    fainter, louder: weighted kbit/s for each nat of log(1 + S/y) at the grid's next lower and next higher S. power:
    with what the UAV interferes at least, times s^2. at_zero, field: kappa(0), and the least of the field. repelled,
    pull: what the price of an interval is made of.
    """

    fainter: float
    louder: float
    power: float
    at_zero: float
    field: float
    repelled: float
    pull: float


@entry
def spread(user: Array, users: Ints, weights: Array, step: float, value: Array, field: Array) -> None:
    """Add sources of `weights` (A,) at `users` (A,) to the field (K,) at all users (K, 2). value: (T,), kappa."""
    for j in range(len(users)):
        east, north, weight = user[users[j], 0], user[users[j], 1], weights[j]
        for k in range(len(user)):
            place = sqrt((user[k, 0] - east) ** 2 + (user[k, 1] - north) ** 2) / step
            n = int(place)
            part = place - n
            field[k] += weight * ((1.0 - part) * value[n] + part * value[n + 1])


@entry
def worth_of_serving(medium: Medium, links: Links, field: Array, worth: Array, feature: Array, bare: Array) -> None:
    """Fill in what each row can be worth by serving each user: worth (M, K), weighted kbit/s.

    field: (K,). feature, bare: of the column that has it, and what it is worth without repulsion.
    """
    value = np.empty(AT_ONCE)
    for m in range(len(links.snr)):
        for k in range(links.snr.shape[1]):
            worth[m, k], feature[m, k], bare[m, k] = 0.0, 0.0, 0.0
            if links.snr[m, k] > 0.0:
                worth[m, k], feature[m, k], bare[m, k] = _best_column(
                    medium,
                    _first_level(medium.levels, links.least[m, k]),
                    links.snr[m, k],
                    links.scale[m, k],
                    links.power[m, k] * medium.room[links.ring[m, k]],
                    field[k] - medium.value_error,
                    value,
                )


@kernel
def _first_level(levels: Array, least: float) -> int:
    """Return the interval of y that holds the least one."""
    return min(max(0, int(np.searchsorted(levels, least)) - 1), len(levels) - 1)


@kernel
def _best_column(
    medium: Medium, first: int, snr: float, scale: float, power: float, field: float, value: Array
) -> tuple[float, float, float]:
    """Return the greatest worth over the intervals of y, its feature, and what it is worth without repulsion.

    Each interval gets the price b that makes its worth least; what is beyond the last level is free. value: (AT_ONCE,),
    scratch.
    """
    levels, logs = medium.levels, medium.logs
    place = max(0.0, (log(snr) - medium.least_log) / medium.log_step)
    n = min(int(place), len(logs) - 2)
    column = Column(
        fainter=scale * (1.0 - (place - n)),
        louder=scale * (place - n),
        power=power,
        at_zero=medium.at_zero,
        field=field,
        repelled=power * medium.at_zero - 1.0,
        pull=max(field, 0.0),
    )
    low, high = logs[n], logs[n + 1]
    beyond = column.fainter * low[-1] + column.louder * high[-1]
    best, at = beyond, -1
    for begin in range(first, len(levels) - 1, AT_ONCE):
        if column.fainter * low[begin] + column.louder * high[begin] <= best:
            break
        end = min(begin + AT_ONCE, len(levels) - 1)
        won = _worth_of_intervals(column, levels, low, high, begin, end, value)
        if won > best:
            best, at = won, begin + _where(value, won)
    if at < 0:
        return beyond, 0.0, beyond
    rate = column.fainter * low[at] + column.louder * high[at]
    after = column.fainter * low[at + 1] + column.louder * high[at + 1]
    pull = column.pull / (levels[at + 1] + column.repelled)
    price, feature = 0.5 * power * pull * pull, power * pull
    bare = max(rate + price * levels[at], after + price * levels[at + 1]) - price
    if bare + 0.5 * feature * feature * medium.at_zero - feature * field > rate:
        return best, 0.0, rate
    return best, feature, bare


@smooth
def _worth_of_intervals(
    column: Column, levels: Array, low: Array, high: Array, begin: int, end: int, value: Array
) -> float:
    """Write what the intervals [begin, end) of y are worth at most into `value`, and return the greatest."""
    fainter, louder, repelled, strength = column.fainter, column.louder, column.repelled, column.pull
    power, half_power, half_zero = column.power, 0.5 * column.power, 0.5 * column.at_zero
    field, best = column.field, -1.0
    for i in range(end - begin):
        y = begin + i
        at_low, at_high = fainter * low[y] + louder * high[y], fainter * low[y + 1] + louder * high[y + 1]
        pull = strength / (levels[y + 1] + repelled)
        price, feature = half_power * pull * pull, power * pull
        bare = max(at_low + price * levels[y], at_high + price * levels[y + 1]) - price
        value[i] = min(at_low, bare + feature * (half_zero * feature - field))
        best = max(best, value[i])
    return best


@kernel
def _where(value: Array, wanted: float) -> int:
    """Return the place of a number that is there."""
    i = 0
    while i < len(value) - 1 and value[i] != wanted:
        i += 1
    return i
