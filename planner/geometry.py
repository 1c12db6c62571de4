"""Plane geometry on paths and segments, in metres east and north: the one place for all floors."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import numpy as np

from skyfolio.planner.arrays import Array

Point = tuple[float, float]
"""East, north in metres from the origin."""


def point_at(path: Sequence[Point], slots: float) -> Point:
    """Return the point `slots` slot durations after the path's first one; beyond its ends, the end.

    path: one point per slot, flown straight and at constant speed between two of them.
    """
    at = min(max(slots, 0.0), len(path) - 1.0)
    low = min(int(at), max(len(path) - 2, 0))
    return between(path[low], path[min(low + 1, len(path) - 1)], at - low)


def between(start: Point, end: Point, share: float) -> Point:
    """Return the point at this share (0: start, 1: end) of the straight way from `start` to `end`."""
    return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])


def distance_to_segment_m(point: Point, start: Point, end: Point) -> float:
    """Return the least distance of a point to the straight segment from `start` to `end`."""
    east, north = end[0] - start[0], end[1] - start[1]
    length2 = east * east + north * north
    to_east, to_north = point[0] - start[0], point[1] - start[1]
    share = 0.0 if length2 == 0 else min(1.0, max(0.0, (to_east * east + to_north * north) / length2))
    return hypot(to_east - share * east, to_north - share * north)


def nearest_to_origin(start: Array, way: Array) -> Array:
    """Return the point of each segment that is nearest to (0, 0).

    start: (..., 2), where each segment begins; way: (..., 2), from there to its end. For the relative position of two
    UAVs within a slot, the result is where they are closest.
    """
    length2 = (way**2).sum(axis=-1)
    share = -(start * way).sum(axis=-1) / np.where(length2 > 0, length2, 1.0)
    nearest: Array = start + np.clip(share, 0.0, 1.0)[..., None] * way
    return nearest
