"""No-fly zones in problem (a7): for each leg a half-plane that holds the leg and none of the zone.

As eq. (21) does for two UAVs, each half-plane is chosen at the last iterate; it is a convex restriction, so what
(a7) returns stays outside, between the slots too.
"""

from __future__ import annotations

from collections.abc import Iterator

import cvxpy as cp
import numpy as np
import shapely

from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import nearest_to_origin
from skyfolio.planner.problem import Problem

MARGIN_M = 1e-4
"""Kept from a zone's edge where the last iterate keeps it too: the interior point method rounds."""


def half_planes(problem: Problem, path_m: Array) -> Iterator[tuple[Array, Array]]:
    """Yield normals (N-1, 2) and offsets (N-1,) for each convex piece of the zones.

    `normal . q >= offset` holds on each leg, and nowhere in the piece. path_m: (N, 2) metres, outside all zones.
    """
    here, there = path_m[:-1], path_m[1:]
    for east, north, radius in problem.discs:
        near = _nearest_to(np.array([east, north]), here, there)
        away = near - (east, north)
        length = np.linalg.norm(away, axis=1, keepdims=True)
        normal = away / np.where(length > 0, length, 1.0)
        yield _with_margin(normal, normal @ (east, north) + radius, here, there)
    for outline in problem.polygons:
        for piece in shapely.constrained_delaunay_triangles(shapely.Polygon(outline)).geoms:
            yield _with_margin(*_separating(shapely.get_coordinates(piece)[:3], here, there), here, there)


def outside(zones: list[tuple[Array, Array]], q: cp.Expression) -> list[cp.Constraint]:
    """Keep both ends of each leg of `q` (N, 2) in the half-planes `zones`, in the unit of their offsets."""
    return [
        cp.sum(cp.multiply(normal, q[end : end + len(normal)]), axis=1) >= offset
        for normal, offset in zones
        for end in (0, 1)
    ]


def _nearest_to(point: Array, here: Array, there: Array) -> Array:
    """Return the point of each segment that is nearest to `point`: (L, 2)."""
    near: Array = point + nearest_to_origin(here - point, there - here)
    return near


def _separating(corners: Array, here: Array, there: Array) -> tuple[Array, Array]:
    """Return the line between a triangle (3, 2) and each segment along which they are furthest apart.

    Two disjoint convex shapes are separated along the normal of one of their edges: three of the triangle, two
    directions across the segment.
    """
    edge = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    outward *= np.sign(((corners - corners.mean(axis=0)) * outward).sum(axis=1))[:, None]
    across = np.stack([there[:, 1] - here[:, 1], here[:, 0] - there[:, 0]], axis=1)  # (L, 2)
    normals = np.concatenate([np.repeat(outward[None], len(here), axis=0), across[:, None], -across[:, None]], axis=1)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    normals = normals / np.where(length > 0, length, 1.0)  # (L, 5, 2)
    offsets = (normals @ corners.T).max(axis=2)
    gaps = np.minimum((normals * here[:, None]).sum(axis=2), (normals * there[:, None]).sum(axis=2)) - offsets
    best = np.argmax(np.where(length[:, :, 0] > 0, gaps, -np.inf), axis=1)
    leg = np.arange(len(here))
    return normals[leg, best], offsets[leg, best]


def _with_margin(normal: Array, offset: Array, here: Array, there: Array) -> tuple[Array, Array]:
    kept = np.minimum((normal * here).sum(axis=1), (normal * there).sum(axis=1)) - offset
    return normal, offset + np.minimum(MARGIN_M, kept)
