"""Turns a nearly feasible path into one that satisfies (6d)-(6g), ends and no-fly zones to the last bit."""

from __future__ import annotations

import numpy as np
import shapely

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import ROUNDING_WH, account_of
from skyfolio.planner.geometry import nearest_to_origin
from skyfolio.planner.problem import Problem
from skyfolio.planner.separation import closest_approach

SHRINK = 1.0 - 1e-9
"""Steps are kept this much below `D_max`, so that rounding never carries one over it."""
ROUNDING_M = 2e-11
"""How far adding up positions within 100 km of the origin may be off in one step."""
SHARE = 1e-12
"""A step this little (relatively) too long is not: rounding."""
INSIDE_M = 5e-10
"""A leg this little inside a no-fly zone touches its edge."""


def step_limits_m(problem: Problem) -> Array:
    """Return the longest step of each UAV, metres: (U,).

    It is `D_max` less rounding, except where an end position lies just as far away as the UAV can fly: such an end is
    in reach, and there the rounding of each step is allowed on top of what the straight way needs.
    """
    limit = problem.step_m * SHRINK
    away = np.linalg.norm(problem.end_m - problem.start_m, axis=1)
    needed = away / np.maximum(problem.n_flying - 1, 1)
    exact: Array = np.where(needed > limit, np.minimum(needed, problem.step_m) + ROUNDING_M, limit)
    return exact


def within_limits(problem: Problem, paths_m: Array) -> Array:
    """Clip each step to `D_max` and each point to the area, from the start on: (U, N, 2) metres.

    Clipping to a box does not stretch a step, so the speed limit survives it. An end position one step away is met
    exactly; a UAV that has left keeps its last position.
    """
    fixed = paths_m.copy()
    fixed[:, 0] = problem.start_m
    last = problem.n_flying - 1
    limit = step_limits_m(problem)
    for n in range(1, problem.n_slots):
        arriving = (last == n)[:, None]
        target = np.where(arriving & np.isfinite(problem.end_m), problem.end_m, paths_m[:, n])
        move = np.where((last < n)[:, None], 0.0, target - fixed[:, n - 1])
        length = np.linalg.norm(move, axis=1)
        longest = _in_wind(problem, limit, move)
        reached = fixed[:, n - 1] + (longest / np.where(length > 0, length, 1.0))[:, None] * move
        fixed[:, n] = np.where((length > longest)[:, None], reached, np.where(move == 0.0, fixed[:, n - 1], target))
        fixed[:, n] = np.clip(fixed[:, n], problem.low_m, problem.high_m)
        if problem.air is not None and problem.air.has_wind:  # the edge has turned the step
            move = fixed[:, n] - fixed[:, n - 1]
            length = np.linalg.norm(move, axis=1)
            share = np.minimum(1.0, _in_wind(problem, limit, move) / np.where(length > 0, length, 1.0))
            fixed[:, n] = np.where(share[:, None] < 1.0 - SHARE, fixed[:, n - 1] + share[:, None] * move, fixed[:, n])
    return fixed


def _in_wind(problem: Problem, limit_m: Array, move_m: Array) -> Array:
    """Return how far each UAV may step in the direction of its move (U, 2): (U,) metres, at most `limit_m`."""
    if problem.air is None or not problem.air.has_wind:
        return limit_m
    farthest: Array = np.minimum(limit_m, problem.air.longest_m(move_m[:, None])[:, 0])
    return farthest


def affordable(problem: Problem, paths_m: Array) -> bool:
    """Return whether every UAV can go home from the end of each slot, with its reserve."""
    air = problem.air
    if air is None or not air.has_energy:
        return True
    return bool((account_of(air, paths_m, problem.n_flying).margin_wh >= -ROUNDING_WH).all())


def separated(problem: Problem, paths_m: Array) -> bool:
    """Return whether no two UAVs come closer than `D_min` while both fly, at the slots and between them."""
    if len(np.unique(problem.n_flying)) == 1:
        return closest_approach(paths_m) >= problem.separation_m
    return all(
        closest_approach(paths_m[problem.n_flying >= flying, :flying]) >= problem.separation_m
        for flying in np.unique(problem.n_flying)
    )


def arrived(problem: Problem, paths_m: Array) -> bool:
    """Return whether every UAV is at its end position, if it has one, in its last slot."""
    there = paths_m[np.arange(problem.n_uavs), problem.n_flying - 1]
    return bool((np.isnan(problem.end_m) | (there == problem.end_m)).all())


def outside_zones(problem: Problem, paths_m: Array) -> bool:
    """Return whether no leg enters a no-fly zone; edges may be touched."""
    zones = [shapely.Polygon(outline).buffer(-INSIDE_M) for outline in problem.polygons]
    for path, flying in zip(paths_m, problem.n_flying, strict=True):
        legs = np.stack([path[:flying], path[[*range(1, flying), flying - 1]]], axis=1)
        if any(_least_distance(legs, disc[:2]) < disc[2] - INSIDE_M for disc in problem.discs):
            return False
        if zones and shapely.intersects(np.array(zones)[:, None], shapely.linestrings(legs)[None]).any():
            return False
    return True


def _least_distance(legs: Array, centre: Array) -> float:
    """Return the least distance of segments (L, 2, 2) to a point."""
    nearest = nearest_to_origin(legs[:, 0] - centre, legs[:, 1] - legs[:, 0])
    return float(np.linalg.norm(nearest, axis=1).min())


def flyable(problem: Problem, paths_m: Array) -> bool:
    """Return whether paths within speed and area limits keep apart, out of zones, reach their ends, and come home."""
    free = arrived(problem, paths_m) and separated(problem, paths_m) and outside_zones(problem, paths_m)
    return free and affordable(problem, paths_m)


def toward(problem: Problem, feasible_m: Array, wanted_m: Array) -> Array:
    """Return the first feasible path at all, half, a quarter, ... of the way from a feasible to a wanted path."""
    wanted_m = within_limits(problem, wanted_m)
    share = 1.0
    while share > 1e-3:
        candidate = within_limits(problem, feasible_m + share * (wanted_m - feasible_m))
        if flyable(problem, candidate):
            return candidate
        share /= 2
    return feasible_m
