"""Trajectories for given links: projected gradient ascent on the displacements, feasible at every iterate.

The variables are the steps v[n] = q[n] - q[n-1], because the speed limit is one disc for each of them. A step moves
all later positions, so the slope of v[n] is the sum of those of q[n], q[n+1], ...; dividing it by their number evens
out the curvature, and as that is one factor for each disc, clipping stays the exact projection. Step lengths are
Barzilai and Borwein's (doi:10.1093/imanum/8.1.141), taken back until the true utility grows: nothing is linearised.
"""

from __future__ import annotations

import numpy as np

from planner.fast.arena import Arena, Array, Links, entry, kernel
from planner.fast.flight import fly
from planner.fast.rates import gradient, link_rates, value

TRIES = 12
FIRST_MOVE_M = 50.0
"""How far the first step moves the position that it moves furthest: about the scale of the channel, `H`."""


@entry
def ascend(arena: Arena, links: Links, path: Array, steps: int, tolerance: float) -> int:
    """Improve `path` (N, 2, U) in place by up to `steps` steps; how many were made.

    It ends early after a step that gains less than `tolerance` of the utility, or when no step gains.
    """
    rate, weight = np.empty(links.khz.shape), np.empty(links.khz.shape)
    slope, wish, trial = np.empty(path.shape), np.zeros(path.shape), np.empty(path.shape)
    direction, last_direction, move = np.zeros(path.shape), np.zeros(path.shape), np.zeros(path.shape)
    link_rates(arena, path, links, rate)
    length, moving, chase = 0.0, np.bool_(True), np.bool_(False)  # literals would be compiled one by one
    best = value(arena, links, rate, moving, weight)
    for made in range(steps):
        gradient(arena, path, links, weight, slope)
        steepest = _direction(arena, slope, direction)
        if steepest == 0.0:
            return made
        if made == 0:
            length = FIRST_MOVE_M / steepest
        else:
            length = _barzilai_borwein(move, direction, last_direction, length, made)
        gained = False
        for _ in range(TRIES):
            _wish(path, direction, length, wish)
            if fly(arena, wish, chase, trial):
                link_rates(arena, trial, links, rate)
                reached = value(arena, links, rate, moving, weight)
                if reached > best:
                    gained = True
                    break
            length *= 0.3
        if not gained:
            return made
        _moved(path, trial, move)
        _copy(trial, path)
        _copy(direction, last_direction)
        gain, best = reached - best, reached
        if gain <= tolerance * abs(best):
            return made + 1
    return steps


@kernel
def _direction(arena: Arena, slope: Array, direction: Array) -> float:
    """The preconditioned slope of the utility in the steps into `direction`; the longest way it moves a position."""
    n_slots, _, n_uavs = slope.shape
    longest2 = 0.0
    for u in range(n_uavs):
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
def _barzilai_borwein(move: Array, direction: Array, last_direction: Array, length: float, made: int) -> float:
    """The next step length: the long and the short one in turn, both in the metric of the preconditioner."""
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
        return 4.0 * length
    return moved2 / turned if made % 2 else turned / turned2


@kernel
def _copy(source: Array, target: Array) -> None:
    for n in range(source.shape[0]):
        for axis in range(source.shape[1]):
            for u in range(source.shape[2]):
                target[n, axis, u] = source[n, axis, u]
