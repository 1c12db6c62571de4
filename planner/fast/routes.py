"""Ways around no-fly zones: the corners where a shortest way may turn, and how many slots each is from an end.

Legs are straight, so a UAV turns only where a slot begins: a way is counted in whole slots from corner to corner.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.air import longest
from skyfolio.planner.fast.arena import Arena, Ints, entry, kernel
from skyfolio.planner.fast.zones import push_from_zones
from skyfolio.planner.problem import Problem

FAR = 1_000_000_000
"""More slots than any plan has: not to be reached."""
DISC_CORNERS = 12
CLEAR_M = 1e-6
"""Corners are passed at this distance."""
MOST_CORNERS = 400
"""Beyond this many, ways lead straight on or not at all: the table of who sees whom would be too large."""


def with_routes(problem: Problem, arena: Arena) -> Arena:
    """Return the arena with the turning points around the zones of `problem`, and how far they are from the ends."""
    turns = _turns(problem)
    if turns.shape[1] == 0:
        return arena
    arena = arena._replace(turns=turns)
    sees = np.zeros((turns.shape[1], turns.shape[1]), dtype=np.int64)
    _look(arena, sees)
    arena = arena._replace(turns=np.ascontiguousarray(turns[:, np.diag(sees) == 1]))
    sees = np.ascontiguousarray(sees[np.diag(sees) == 1][:, np.diag(sees) == 1])
    arena = arena._replace(sees=sees)
    left = np.full((problem.n_uavs, len(sees)), FAR)
    for u in range(problem.n_uavs):
        if np.isnan(problem.end_m[u, 0]):
            continue
        slots_to(arena, sees, u, arena.end_m[:, u].copy(), left[u])
    return arena._replace(left=left)


def _turns(problem: Problem) -> Array:
    """Corners of the zones, a little outside, as far as they lie in the area: (2, C)."""
    angle = 2 * np.pi * np.arange(DISC_CORNERS) / DISC_CORNERS
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = [disc[:2] + (disc[2] + CLEAR_M) / np.cos(np.pi / DISC_CORNERS) * around for disc in problem.discs]
    found += [_widened(outline) for outline in problem.polygons]
    if not found or sum(map(len, found)) > MOST_CORNERS:
        return np.zeros((2, 0))
    corners = np.vstack(found)
    inside = ((corners >= problem.low_m) & (corners <= problem.high_m)).all(axis=1)
    return np.ascontiguousarray(corners[inside].T)


def _widened(outline: Array) -> Array:
    """Return the corners of a polygon (V, 2), each moved out along the bisector of its edges."""
    edges = np.roll(outline, -1, axis=0) - outline
    unit = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    following = np.roll(outline, -1, axis=0)
    turning = np.sign((outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum())
    outwards = np.stack([unit[:, 1], -unit[:, 0]], axis=1) * turning
    bisector = outwards + np.roll(outwards, 1, axis=0)
    length = np.linalg.norm(bisector, axis=1, keepdims=True)
    moved: Array = outline + 2 * CLEAR_M * bisector / np.where(length > 0, length, 1.0)
    return moved


@entry
def _look(arena: Arena, sees: Ints) -> None:
    """Which turning points see each other, into `sees` (C, C); on the diagonal, which lie outside all zones."""
    turns = arena.turns
    for a in range(turns.shape[1]):
        for b in range(a, turns.shape[1]):
            sees[a, b] = sees[b, a] = free(arena, turns[0, a], turns[1, a], turns[0, b], turns[1, b])


@kernel
def free(arena: Arena, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether the straight leg enters no zone."""
    _, _, entered = push_from_zones(arena, x0, y0, x1, y1)
    return not entered


@entry
def slots_to(arena: Arena, sees: Ints, u: int, end_m: Array, left: Ints) -> None:
    """Write how many slots UAV u needs from each turning point to `end_m` (2,) into `left` (C,).

    By Dijkstra's algorithm.
    """
    turns, count = arena.turns, left.shape[0]
    done = np.zeros(count, dtype=np.int64)
    for c in range(count):
        left[c] = FAR
        if free(arena, turns[0, c], turns[1, c], end_m[0], end_m[1]):
            left[c] = whole_slots(arena, u, end_m[0] - turns[0, c], end_m[1] - turns[1, c])
    for _ in range(count):
        nearest = _nearest_open(left, done)
        if left[nearest] >= FAR:
            return
        done[nearest] = 1
        for c in range(count):
            if sees[c, nearest] == 1:
                dx, dy = turns[0, nearest] - turns[0, c], turns[1, nearest] - turns[1, c]
                left[c] = min(left[c], left[nearest] + whole_slots(arena, u, dx, dy))


@kernel
def _nearest_open(left: Ints, done: Ints) -> int:
    nearest, least = 0, FAR + 1
    for c in range(left.shape[0]):
        if done[c] == 0 and left[c] < least:
            nearest, least = c, left[c]
    return nearest


@kernel
def reach_of_step(arena: Arena, u: int, dx: float, dy: float) -> float:
    """Return how far UAV u flies in a slot in the direction (dx, dy), metres: `D_max`, or less in wind."""
    return longest(arena.breeze, u, arena.step_m[u], dx, dy) if arena.has_wind else float(arena.step_m[u])


@kernel
def whole_slots(arena: Arena, u: int, dx: float, dy: float) -> int:
    """Slots in which UAV u flies a straight way of (dx, dy) metres."""
    away = np.hypot(dx, dy)
    if away == 0.0:
        return 0
    step_m = reach_of_step(arena, u, dx, dy)
    return int(np.ceil(away / step_m - 1e-9)) if step_m > 0.0 else FAR


@kernel
def way_on(
    arena: Arena, left: Ints, u: int, x: float, y: float, end_x: float, end_y: float
) -> tuple[int, float, float]:
    """(slots from (x, y) to the end, where to fly next) for UAV u; left: (C,) slots from each turning point."""
    if free(arena, x, y, end_x, end_y):
        return whole_slots(arena, u, end_x - x, end_y - y), end_x, end_y
    turns, least, to_x, to_y = arena.turns, FAR, x, y
    for c in range(left.shape[0]):
        if left[c] >= least:
            continue
        slots = left[c] + whole_slots(arena, u, turns[0, c] - x, turns[1, c] - y)
        if slots < least and free(arena, x, y, turns[0, c], turns[1, c]):
            least, to_x, to_y = slots, turns[0, c], turns[1, c]
    return least, to_x, to_y


@kernel
def one_step(arena: Arena, u: int, x: float, y: float, to_x: float, to_y: float) -> tuple[float, float]:
    """Straight on towards (to_x, to_y), at most `D_max`."""
    away = np.hypot(to_x - x, to_y - y)
    limit = reach_of_step(arena, u, to_x - x, to_y - y)
    if away <= limit:
        return to_x, to_y
    share = limit / away
    return x + share * (to_x - x), y + share * (to_y - y)


@entry
def walk(arena: Arena, u: int, left: Ints, target_m: Array, begin: int, wish: Array) -> None:
    """From slot `begin` on, fill column u of `wish` (N, 2, U) with the way to `target_m` (2,), and a hover there."""
    x, y = arena.start_m[0, u], arena.start_m[1, u]
    if begin > 0:
        x, y = wish[begin - 1, 0, u], wish[begin - 1, 1, u]
    for n in range(begin, wish.shape[0]):
        if n > 0:
            slots, to_x, to_y = way_on(arena, left, u, x, y, target_m[0], target_m[1])
            if slots >= FAR:
                to_x, to_y = target_m[0], target_m[1]
            x, y = one_step(arena, u, x, y, to_x, to_y)
        wish[n, 0, u], wish[n, 1, u] = x, y


def lead(arena: Arena, u: int, target_m: Array, begin: int, wish: Array) -> None:
    """As `walk`, with the way around the zones worked out for this target."""
    count = arena.turns.shape[1]
    left = np.empty(count, dtype=np.int64)
    if count:
        slots_to(arena, arena.sees, u, target_m, left)
    walk(arena, u, left, target_m, begin, wish)
