"""Between which altitudes UAVs may fly their paths: above ground and ways home, and no faster than they climb.

A leg asks the same of both its ends: with either of them above its highest ground, a vehicle that climbs sooner or
later than on a straight line is above it too. A vehicle that returns keeps its altitude or climbs (both common
autopilots), so an altitude above the highest ground between a leg and home makes every way home from that leg safe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.ground.ground import Ground

ROUNDING_M = 1e-6
"""Altitudes are kept this much above the ground, so that rounding takes none below."""


@dataclass(frozen=True)
class Room:
    """floor_m, ceiling_m: (U, N), the least and the greatest altitudes that can be flown one after the other.

    A path can be flown where no floor is above its ceiling. The ceiling is infinite where altitudes are not chosen.
    """

    floor_m: Array
    ceiling_m: Array

    def is_flyable(self) -> NDArray[np.bool_]:
        """Return for each UAV whether its path can be flown: (U,)."""
        flyable: NDArray[np.bool_] = np.all(self.floor_m <= self.ceiling_m + ROUNDING_M, axis=1)
        return flyable


def room_over(ground: Ground, paths_m: Array) -> Room:
    """Return the room along paths (U, N, 2), metres east/north."""
    under, homeward = _highest(ground, paths_m)
    floor = np.maximum(under + ground.low_m[:, None], homeward + ground.clearance_m) + ROUNDING_M
    ceiling = under + ground.high_m[:, None] + 2 * ROUNDING_M
    flies = np.isfinite(ground.start_m)
    if flies.any():
        start, least = _begun(ground, paths_m)
        floor[flies, 0] = np.maximum(floor[flies, 0], start[flies])
        descending = start[:, None] - ground.climb_m[:, None] * np.arange(floor.shape[1])
        at_worst = np.maximum(descending, least[:, None])  # it may be where nobody would have sent it
        ceiling[flies] = np.maximum(ceiling, at_worst)[flies]
        ceiling[flies, 0] = start[flies]
    return Room(highest_slopes(floor, ground.climb_m), -highest_slopes(-ceiling, ground.climb_m))


def _begun(ground: Ground, paths_m: Array) -> tuple[Array, Array]:
    """Return the altitude from which each UAV goes on, and the least one at its place: (U,) metres each.

    Who is too low for its place is taken to be just high enough: the plan leads back.
    """
    under, homeward = _highest(ground, paths_m[:, :1])
    least = np.maximum(under[:, 0] + ground.low_m, homeward[:, 0] + ground.clearance_m) + ROUNDING_M
    return np.fmax(ground.start_m, least), least


def highest_slopes(levels_m: Array, climb_m: Array) -> Array:
    """Return the lowest altitudes (U, N) at or above `levels_m` that change by at most `climb_m` (U,) in a slot."""
    raised = levels_m.copy()
    for n in range(1, raised.shape[1]):
        raised[:, n] = np.maximum(raised[:, n], raised[:, n - 1] - climb_m)
    for n in range(raised.shape[1] - 2, -1, -1):
        raised[:, n] = np.maximum(raised[:, n], raised[:, n + 1] - climb_m)
    return raised


def _highest(ground: Ground, paths_m: Array) -> tuple[Array, Array]:
    """Return the highest ground under the legs that meet in each slot, and between them and home: (U, N) each."""
    n_uavs, n_slots = paths_m.shape[:2]
    ends = np.concatenate([paths_m[:, 1:], paths_m[:, -1:]], axis=1)
    last = np.arange(n_slots) >= ground.n_flying[:, None] - 1
    ends = np.where(last[:, :, None], paths_m, ends)  # after its last slot a UAV stays in the table
    home = np.repeat(ground.home_m[:, None], n_slots, axis=1)
    flat = [points.reshape(-1, 2) for points in (home, paths_m, ends)]
    under = ground.terrain.highest_on_segments(flat[1], flat[2]).reshape(n_uavs, n_slots)
    way_home = ground.terrain.highest_on_segments(flat[0], flat[1]).reshape(n_uavs, n_slots)  # a side of two triangles
    after = np.where(last, way_home, np.concatenate([way_home[:, 1:], way_home[:, -1:]], axis=1))
    inside = ground.terrain.highest_places_in(*flat).reshape(n_uavs, n_slots)
    homeward = np.maximum.reduce([under, way_home, after, inside])
    return _of_both_legs(under), _of_both_legs(homeward)


def _of_both_legs(of_leg: Array) -> Array:
    """Return the greater value of the legs that begin and end in each slot: (U, N)."""
    both = of_leg.copy()
    both[:, 1:] = np.maximum(of_leg[:, 1:], of_leg[:, :-1])
    return both
