"""Compiled kernels of branch and bound: bound, split and keep rectangles of UAV positions (at most three UAVs).

Arrays of one slot: node (U, 4) is a rectangle per UAV, west, south, east, north in metres; centres (2, U, 2) and radii
(2, U) are the discs of `planner.reach`; gain (U, K) is the SNR gain in m^2; scale (U,) turns nats/s/Hz into kbit/s;
height2 (U, K), what a squared distance over the ground lacks, m^2; weights (K,). cells (capacity, U, 4) and
keys (capacity,) hold the open nodes as a binary heap, the best at 0.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array

Indices: TypeAlias = NDArray[np.intp]
ROUNDING_M = 1e-6
FAR_M = 1e9


@njit(cache=True)
def split_cells(
    cells: Array,
    keys: Array,
    n_open: int,
    best: float,
    count: int,
    tolerance: float,
    centres: Array,
    radii: Array,
    discs: Array,
    users: Array,
    height2: Array,
    gain: Array,
    scale: Array,
    weights: Array,
    found: Array,
) -> tuple[int, float, int]:
    """Up to `count` times: take the best node, halve one rectangle, bound both halves, keep what may beat `best`.

    Stops when no open node is above `best` by more than `tolerance`. Returns open nodes, best value, nodes split;
    found: (K,), the rates in kbit/s that have the best value.
    """
    n_uavs, n_users = gain.shape
    strong, weak = np.empty((n_uavs, n_users)), np.empty((n_uavs, n_users))
    value = np.zeros((3, n_users + 1))
    chosen = np.empty(3, dtype=np.intp)
    node = np.empty((n_uavs, 4))
    rates = np.empty(n_users)
    done = 0
    while done < count and n_open > 0 and keys[0] > best * (1.0 + tolerance):
        node[:] = cells[0]
        n_open = _pop(cells, keys, n_open)
        done += 1
        _snr_range(node, centres, radii, users, height2, gain, strong, weak)
        _assign(strong, weak, scale, weights, value, chosen)
        uav = _most_uncertain(node, strong, weak, chosen)
        axis = 0 if node[uav, 2] - node[uav, 0] >= node[uav, 3] - node[uav, 1] else 1
        middle = 0.5 * (node[uav, axis] + node[uav, axis + 2])
        for side in range(2):
            moved = axis + 2 * (1 - side)
            kept = node[uav, moved]
            node[uav, moved] = middle
            if _possible(node[uav], centres[:, uav], radii[:, uav], discs):
                middle_value = _middle_value(node, centres, radii, discs, users, height2, gain, scale, weights, rates)
                if middle_value > best:
                    best = middle_value
                    found[:] = rates
                _snr_range(node, centres, radii, users, height2, gain, strong, weak)
                bound = _assign(strong, weak, scale, weights, value, chosen)
                if bound > best:
                    n_open = _push(cells, keys, n_open, node, bound)
            node[uav, moved] = kept
    return n_open, best, done


@njit(cache=True)
def _hypot(x: float, y: float) -> float:
    """Return a third of the time of `np.hypot`, which guards against overflow."""
    return float(np.sqrt(x * x + y * y))


@njit(cache=True)
def _snr_range(
    node: Array, centres: Array, radii: Array, users: Array, height2: Array, gain: Array, strong: Array, weak: Array
) -> None:
    """Fill in the greatest and the least SNR of each pair over rectangle and reach."""
    for u in range(gain.shape[0]):
        for k in range(gain.shape[1]):
            e, n = users[k, 0], users[k, 1]
            near = _hypot(max(node[u, 0] - e, 0.0, e - node[u, 2]), max(node[u, 1] - n, 0.0, n - node[u, 3]))
            far = _hypot(max(e - node[u, 0], node[u, 2] - e), max(n - node[u, 1], node[u, 3] - n))
            for c in range(2):
                away = _hypot(e - centres[c, u, 0], n - centres[c, u, 1])
                near = max(near, away - radii[c, u])
                far = min(far, away + radii[c, u])
            strong[u, k] = gain[u, k] / (near * near + height2[u, k])
            weak[u, k] = gain[u, k] / (far * far + height2[u, k])


@njit(cache=True)
def _assign(strong: Array, weak: Array, scale: Array, weights: Array, value: Array, chosen: Indices) -> float:
    """Return the best assignment of distinct users to UAVs: its value, and in `chosen` the users (n_users: none).

    Of a UAV's U best users at least one is not taken by the others, so only those and "none" are tried.
    """
    n_uavs, n_users = strong.shape
    for u in range(n_uavs):
        for k in range(n_users):
            others = 1.0
            for i in range(n_uavs):
                if i != u:
                    others += weak[i, k]
            value[u, k] = weights[k] * scale[u] * np.log1p(strong[u, k] / others)
    top = _best_users(value, n_uavs)
    best = -1.0
    for first in top[0]:
        for second in top[1]:
            for third in top[2]:
                if _clash(first, second, third, n_users):
                    continue
                total = value[0, first] + value[1, second] + value[2, third]
                if total > best:
                    best = total
                    chosen[0], chosen[1], chosen[2] = first, second, third
    return best


@njit(cache=True)
def _clash(first: int, second: int, third: int, none: int) -> bool:
    """Return whether one user is given to two UAVs."""
    if first != none and first in (second, third):
        return True
    return second != none and second == third


@njit(cache=True)
def _best_users(value: Array, n_uavs: int) -> Indices:
    """Return the three best users of each UAV and "none": (3, 4) indices into the rows of `value` (3, K + 1)."""
    none = value.shape[1] - 1
    top = np.full((3, 4), none)
    for u in range(n_uavs):
        for k in range(none):
            place = 3
            while place > 0 and (top[u, place - 1] == none or value[u, k] > value[u, top[u, place - 1]]):
                place -= 1
            for later in range(2, place, -1):
                top[u, later] = top[u, later - 1]
            if place < 3:
                top[u, place] = k
    return top


@njit(cache=True)
def _most_uncertain(node: Array, strong: Array, weak: Array, chosen: Indices) -> int:
    """Return the UAV whose rectangle leaves most open: in its own rate, and in the rates it interferes with."""
    n_uavs, n_users = strong.shape
    worst, which = -1.0, 0
    for u in range(n_uavs):
        score = 0.0
        for j in range(n_uavs):
            k = chosen[j]
            if k == n_users:
                continue
            others = 0.0 if j == u else 1.0
            for i in range(n_uavs):
                if i not in (j, u):
                    others += weak[i, k] if j != u else 0.0
            score += np.log((others + strong[u, k] + 1e-30) / (others + weak[u, k] + 1e-30))
        if score > worst and max(node[u, 2] - node[u, 0], node[u, 3] - node[u, 1]) > ROUNDING_M:
            worst, which = score, u
    return which


@njit(cache=True)
def _possible(cell: Array, centres: Array, radii: Array, discs: Array) -> bool:
    """Return whether the rectangle can hold a reachable point that no no-fly disc covers."""
    for c in range(2):
        de = max(cell[0] - centres[c, 0], 0.0, centres[c, 0] - cell[2])
        dn = max(cell[1] - centres[c, 1], 0.0, centres[c, 1] - cell[3])
        if _hypot(de, dn) > radii[c] + ROUNDING_M:
            return False
    for d in range(discs.shape[0]):
        de = max(discs[d, 0] - cell[0], cell[2] - discs[d, 0])
        dn = max(discs[d, 1] - cell[1], cell[3] - discs[d, 1])
        if _hypot(de, dn) < discs[d, 2] - ROUNDING_M:
            return False
    return True


@njit(cache=True)
def _middle_value(
    node: Array,
    centres: Array,
    radii: Array,
    discs: Array,
    users: Array,
    height2: Array,
    gain: Array,
    scale: Array,
    weights: Array,
    rates: Array,
) -> float:
    """Return the value with each UAV in the middle of its rectangle, pulled into the start's disc.

    Also writes its `rates` (K,). The value is 0 if a UAV cannot be there.
    """
    n_uavs, n_users = gain.shape
    point = np.empty((n_uavs, 4))
    for u in range(n_uavs):
        e = 0.5 * (node[u, 0] + node[u, 2]) - centres[0, u, 0]
        n = 0.5 * (node[u, 1] + node[u, 3]) - centres[0, u, 1]
        away = _hypot(e, n)
        shrink = min(1.0, radii[0, u] / away) if away > 0.0 else 1.0
        point[u, 0] = point[u, 2] = centres[0, u, 0] + shrink * e
        point[u, 1] = point[u, 3] = centres[0, u, 1] + shrink * n
        if not _possible(point[u], centres[:, u], radii[:, u], discs):
            return 0.0
    snr = np.empty((n_uavs, n_users))
    _snr_range(point, centres, np.full_like(radii, FAR_M), users, height2, gain, snr, np.empty_like(snr))
    chosen = np.empty(3, dtype=np.intp)
    best: float = _assign(snr, snr, scale, weights, np.zeros((3, n_users + 1)), chosen)
    rates[:] = 0.0
    for u in range(n_uavs):
        k = chosen[u]
        if k < n_users:
            others = 1.0
            for i in range(n_uavs):
                if i != u:
                    others += snr[i, k]
            rates[k] = scale[u] * np.log1p(snr[u, k] / others)
    return best


@njit(cache=True)
def _push(cells: Array, keys: Array, n_open: int, node: Array, key: float) -> int:
    """Add a node to the heap; how many there are."""
    at = n_open
    while at > 0 and keys[(at - 1) // 2] < key:
        keys[at] = keys[(at - 1) // 2]
        cells[at] = cells[(at - 1) // 2]
        at = (at - 1) // 2
    keys[at] = key
    cells[at] = node
    return n_open + 1


@njit(cache=True)
def _pop(cells: Array, keys: Array, n_open: int) -> int:
    """Remove the best node from the heap; how many are left."""
    last = n_open - 1
    key, at = keys[last], 0
    while True:
        child = 2 * at + 1
        if child >= last:
            break
        if child + 1 < last and keys[child + 1] > keys[child]:
            child += 1
        if keys[child] <= key:
            break
        keys[at] = keys[child]
        cells[at] = cells[child]
        at = child
    keys[at] = key
    cells[at] = cells[last]
    return last
