"""Rates of the links and their slope, UAV by UAV: the loop over links is the inner one. For wide tables of links."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Ints, Links, kernel, smooth
from skyfolio.planner.fast.elementary import PER_LN2, log


class Row(NamedTuple):
    """Those links of one slot that have bandwidth, side by side: the first of W entries are filled.

    link: which link it is; uav: whose it is; east, north: where its user is, metres; spread: m^2, added to squared
    distances from there. gain: (W,), scratch for m^2 of one
    UAV to these users. own, others: SNR from the own UAV, and 1 + that from all others. near, signal: (U, W), 1/d^2 of
    all and the SNR of the others. push, pull: (W,), scratch.
    """

    link: Ints
    uav: Ints
    east: Array
    north: Array
    spread: Array
    gain: Array
    own: Array
    others: Array
    near: Array
    signal: Array
    push: Array
    pull: Array


@kernel
def row_of(n_uavs: int, width: int) -> Row:
    """Tables of the right size, not filled."""
    return Row(
        np.empty(width, dtype=np.int64),
        np.empty(width, dtype=np.int64),
        np.empty(width),
        np.empty(width),
        np.empty(width),
        np.empty(width),
        np.empty(width),
        np.empty(width),
        np.empty((n_uavs, width)),
        np.empty((n_uavs, width)),
        np.empty(width),
        np.empty(width),
    )


@kernel
def _gather(user_m: Array, links: Links, n: int, row: Row) -> int:
    """Put the links of slot n that have bandwidth side by side; how many. user_m: (3, K), of the slot."""
    link, uav, east, north, spread = row.link, row.uav, row.east, row.north, row.spread
    users, uavs, khz = links.user[n], links.uav[n], links.khz[n]
    found = 0
    for j in range(links.used[n]):
        if khz[j] != 0.0:
            k = users[j]
            link[found], uav[found], east[found], north[found] = j, uavs[j], user_m[0, k], user_m[1, k]
            spread[found] = user_m[2, k]
            found += 1
    return found


@kernel
def _listen(arena: Arena, path: Array, links: Links, n: int, row: Row, found: int) -> None:
    """Fill in what the users of the gathered links receive in slot n: `near`, `signal`, `own` and `others`."""
    for j in range(found):
        row.own[j], row.others[j] = 0.0, 1.0
    sampled = arena.fading.shape[0] > 0
    for i in range(path.shape[2]):
        row.gain[0] = arena.gain[n, i]
        if sampled:
            for j in range(found):
                row.gain[j] = arena.fading[n, i, links.user[n, row.link[j]]]
        _listen_to(path[n, 0, i], path[n, 1, i], arena.height2[i], i, sampled, found, row, row.near[i], row.signal[i])


@smooth
def _listen_to(
    x: float, y: float, height2: float, i: int, sampled: bool, found: int, row: Row, near: Array, signal: Array
) -> None:
    """Add UAV i at (x, y) metres. What is its users' own is kept apart: nothing is subtracted, so nothing cancels."""
    east, north, spread, uav = row.east, row.north, row.spread, row.uav
    gain, own, others = row.gain, row.own, row.others
    same = gain[0]
    for j in range(found):
        de, dn = x - east[j], y - north[j]
        near[j] = 1.0 / (de * de + dn * dn + (height2 + spread[j]))
        heard = (gain[j] if sampled else same) * near[j]
        mine = uav[j] == i
        signal[j] = 0.0 if mine else heard
        others[j] += signal[j]
        own[j] = heard if mine else own[j]


@kernel
def rates_by_uav(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """Rate of every link, kbit/s, into `rate` (N, W). path: (N, 2, U)."""
    row = row_of(path.shape[2], rate.shape[1])
    for n in range(path.shape[0]):
        found = _gather(arena.user_m[n * arena.per_slot], links, n, row)
        _listen(arena, path, links, n, row, found)
        _rates(row.own, row.others, found, row.push)
        for j in range(links.used[n]):
            rate[n, j] = 0.0
        for j in range(found):
            rate[n, row.link[j]] = links.khz[n, row.link[j]] * row.push[j]


@smooth
def _rates(own: Array, others: Array, found: int, efficiency: Array) -> None:
    for j in range(found):
        efficiency[j] = PER_LN2 * log((own[j] + others[j]) / others[j])


@kernel
def gradient_by_uav(arena: Arena, path: Array, links: Links, weight: Array, slope: Array) -> None:
    """sum_j weight[n, j] d rate[n, j] / d path[n] into `slope` (N, 2, U); 0 in slot 0, which is fixed."""
    row = row_of(path.shape[2], weight.shape[1])
    for i in range(path.shape[2]):
        slope[0, 0, i] = slope[0, 1, i] = 0.0
    for n in range(1, path.shape[0]):
        found = _gather(arena.user_m[n * arena.per_slot], links, n, row)
        _listen(arena, path, links, n, row, found)
        for j in range(found):
            scale = weight[n, row.link[j]] * links.khz[n, row.link[j]] * (2.0 * PER_LN2)
            row.pull[j] = scale * row.own[j] / (row.own[j] + row.others[j])
            row.push[j] = row.pull[j] / row.others[j]
        for i in range(path.shape[2]):
            slope[n, 0, i], slope[n, 1, i] = _slope(
                path[n, 0, i], path[n, 1, i], i, found, row, row.near[i], row.signal[i]
            )


@smooth
def _slope(x: float, y: float, i: int, found: int, row: Row, near: Array, signal: Array) -> tuple[float, float]:
    """Return the slope of the links in the position of UAV i: its own pull it to their users, the others push it."""
    east, north, uav, push, pull = row.east, row.north, row.uav, row.push, row.pull
    to_east = to_north = 0.0
    for j in range(found):
        strength = near[j] * (push[j] * signal[j] - (pull[j] if uav[j] == i else 0.0))
        to_east += strength * (x - east[j])
        to_north += strength * (y - north[j])
    return to_east, to_north
