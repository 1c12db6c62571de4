"""Trajectories for given links: projected gradient ascent on the displacements, feasible at every iterate.

The variables are the steps v[n] = q[n] - q[n-1], because the speed limit is one disc for each of them. A step moves
all later positions, so the slope of v[n] is the sum of those of q[n], q[n+1], ...; dividing it by their number evens
out the curvature, and as that is one factor for each disc, clipping stays the exact projection. Step lengths are
Barzilai and Borwein's (doi:10.1093/imanum/8.1.141), taken back until the true utility grows: nothing is linearised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Links, is_pinned, kernel
from skyfolio.planner.fast.flight import fly
from skyfolio.planner.fast.floors import free_bands, refit, reweigh
from skyfolio.planner.fast.rates import gradient, link_rates, value
from skyfolio.planner.fast.tolls import lean_back, price_of_way

TRIES = 12
FIRST_MOVE_M = 50.0
"""How far the first step moves the position that it moves furthest: about the scale of the channel, `H`."""


class Ascent(NamedTuple):
    """Scratch of an ascent. rate, weight, free and khz: (N, W), of the links; length: (1,); the rest (N, 2, U)."""

    rate: Array
    weight: Array
    slope: Array
    wish: Array
    trial: Array
    direction: Array
    last_direction: Array
    move: Array
    free: Array
    khz: Array
    length: Array


@kernel
def ascent_of(path: Array, links: Links) -> Ascent:
    """Scratch of the right size."""
    return Ascent(
        np.empty(links.khz.shape),
        np.empty(links.khz.shape),
        np.empty(path.shape),
        np.zeros(path.shape),
        np.empty(path.shape),
        np.zeros(path.shape),
        np.zeros(path.shape),
        np.zeros(path.shape),
        np.empty(links.khz.shape),
        np.empty(links.khz.shape),
        np.zeros(1),
    )


@kernel
def ascend(arena: Arena, links: Links, path: Array, steps: int, tolerance: float, scratch: Ascent) -> int:
    """Improve `path` (N, 2, U) in place by up to `steps` steps; how many were made.

    It ends early after a step that gains less than `tolerance` of the utility, or when no step gains.
    """
    moving = np.bool_(not arena.has_price)  # a price is paid for the utility itself
    link_rates(arena, path, links, scratch.rate)
    best = value(arena, links, scratch.rate, moving, scratch.weight) - price_of_way(arena, path)
    for made in range(steps):
        if arena.has_floors:
            free_bands(links, scratch.rate, scratch.free)
            reweigh(arena, links, scratch.free, scratch.rate, scratch.weight)
        gradient(arena, path, links, scratch.weight, scratch.slope)
        lean_back(arena, path, scratch.slope)
        furthest = _direction(arena, scratch.slope, scratch.direction)
        if furthest == 0.0:
            return made
        if made > 0:
            scratch.length[0] = _barzilai_borwein(scratch, made)
        elif scratch.length[0] == 0.0 or scratch.length[0] * furthest > FIRST_MOVE_M:
            scratch.length[0] = FIRST_MOVE_M / furthest
        reached = _search(arena, links, path, best, scratch)
        if reached <= best:
            return made
        if arena.has_floors:
            links.khz[:] = scratch.khz
        _moved(path, scratch.trial, scratch.move)
        _copy(scratch.trial, path)
        _copy(scratch.direction, scratch.last_direction)
        gain, best = reached - best, reached
        if gain <= tolerance * abs(best):
            return made + 1
    return steps


@kernel
def _search(arena: Arena, links: Links, path: Array, best: float, scratch: Ascent) -> float:
    """Shorten the step until the utility exceeds `best`: the value reached, at `scratch.trial`; `best` if it never."""
    moving, chase = np.bool_(not arena.has_price), np.bool_(False)
    for _ in range(TRIES):
        _wish(path, scratch.direction, scratch.length[0], scratch.wish)
        if fly(arena, scratch.wish, chase, scratch.trial):
            link_rates(arena, scratch.trial, links, scratch.rate)
            if not arena.has_floors or refit(arena, links, scratch.free, scratch.rate, scratch.khz):
                reached = value(arena, links, scratch.rate, moving, scratch.weight)
                reached -= price_of_way(arena, scratch.trial)
                if reached > best:
                    return reached
        scratch.length[0] *= 0.3
    return best


@kernel
def _direction(arena: Arena, slope: Array, direction: Array) -> float:
    """Write the preconditioned slope of the utility in the steps into `direction`.

    Returns the longest way that it moves a position.
    """
    n_slots, _, n_uavs = slope.shape
    longest2 = 0.0
    for u in range(n_uavs):
        if arena.has_pinned and is_pinned(arena, u):
            continue
        east = north = way_e = way_n = 0.0
        last = min(n_slots - 1, arena.last[u])
        for n in range(last, 0, -1):
            east += slope[n, 0, u]
            north += slope[n, 1, u]
            direction[n, 0, u], direction[n, 1, u] = east / (last - n + 1), north / (last - n + 1)
        for n in range(1, last + 1):
            way_e += direction[n, 0, u]
            way_n += direction[n, 1, u]
            longest2 = max(longest2, way_e * way_e + way_n * way_n)
    return float(np.sqrt(longest2))


@kernel
def _wish(path: Array, direction: Array, length: float, wish: Array) -> None:
    for n in range(1, path.shape[0]):
        for axis in range(2):
            for u in range(path.shape[2]):
                wish[n, axis, u] = path[n, axis, u] - path[n - 1, axis, u] + length * direction[n, axis, u]


@kernel
def _moved(path: Array, trial: Array, move: Array) -> None:
    for n in range(1, path.shape[0]):
        for axis in range(2):
            for u in range(path.shape[2]):
                now = trial[n, axis, u] - trial[n - 1, axis, u]
                move[n, axis, u] = now - (path[n, axis, u] - path[n - 1, axis, u])


@kernel
def _barzilai_borwein(scratch: Ascent, made: int) -> float:
    """Return the next step length: the long and the short one in turn, both in the metric of the preconditioner."""
    move, direction, last_direction = scratch.move, scratch.direction, scratch.last_direction
    n_slots = move.shape[0]
    moved2 = turned = turned2 = 0.0
    for n in range(1, n_slots):
        metric = float(n_slots - n)
        for axis in range(2):
            for u in range(move.shape[2]):
                s, y = move[n, axis, u], last_direction[n, axis, u] - direction[n, axis, u]
                moved2 += metric * s * s
                turned += metric * s * y
                turned2 += metric * y * y
    if turned <= 0.0:
        return float(4.0 * scratch.length[0])
    return moved2 / turned if made % 2 else turned / turned2


@kernel
def _copy(source: Array, target: Array) -> None:
    for n in range(source.shape[0]):
        for axis in range(source.shape[1]):
            for u in range(source.shape[2]):
                target[n, axis, u] = source[n, axis, u]
