"""Straight legs against discs and polygons: how to push a leg's end so that the leg stays outside."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Ints, kernel

SLACK_M = 1e-10
"""A leg this little too close is not: rounding."""
MARGIN_M = 1e-7
"""Legs are pushed out this much further than they must."""


@kernel
def push_out(x0: float, y0: float, x1: float, y1: float, radius: float) -> tuple[float, float]:
    """By how much (x1, y1) must move for the leg from (x0, y0) to stay `radius` away from (0, 0); metres, 0 if it does.

    Where the end is nearest it moves straight outwards, otherwise to the tangent through (x0, y0): both keep the
    whole leg on the far side of a line that touches the disc.
    """
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    along = 0.0 if length2 == 0.0 else min(1.0, max(0.0, -(x0 * dx + y0 * dy) / length2))
    cx, cy = x0 + along * dx, y0 + along * dy
    near = np.hypot(cx, cy)
    if near >= radius - SLACK_M or along == 0.0:
        return 0.0, 0.0
    begin = np.hypot(x0, y0)
    if near > 0.0 and (cx * x0 + cy * y0) / near >= radius:
        nx, ny = cx / near, cy / near
    else:
        cosine = min(1.0, radius / begin)
        sine = np.sqrt(1.0 - cosine * cosine)
        ux, uy = x0 / begin, y0 / begin
        side = 1.0 if ux * cy - uy * cx >= 0.0 else -1.0
        nx, ny = cosine * ux - side * sine * uy, cosine * uy + side * sine * ux
    short = radius + MARGIN_M - (nx * x1 + ny * y1)
    return short * nx, short * ny


@kernel
def push_from_zones(arena: Arena, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
    """(push of (x1, y1) in metres, whether the leg from (x0, y0) enters a zone) for the first zone that it enters."""
    for d in range(arena.discs.shape[0]):
        east, north, radius = arena.discs[d, 0], arena.discs[d, 1], arena.discs[d, 2]
        px, py = push_out(x0 - east, y0 - north, x1 - east, y1 - north, radius)
        if px != 0.0 or py != 0.0:
            return px, py, True
    for p in range(arena.first.shape[0] - 1):
        corners = arena.corners[arena.first[p] : arena.first[p + 1]]
        edge = entered_edge(corners, x0, y0, x1, y1)
        if edge >= 0:
            px, py = _slide(corners, edge, x1, y1)
            return px, py, True
    return 0.0, 0.0, False


@kernel
def entered_edge(corners: Array, x0: float, y0: float, x1: float, y1: float) -> int:
    """Return the edge through which the leg enters the inside of the polygon `corners` (V, 2), or -1."""
    if _beside(corners, x0, y0, x1, y1):
        return -1
    n = corners.shape[0]
    at, edges = np.empty(2 * n + 2), np.empty(2 * n + 2, dtype=np.int64)
    count = _crossings(corners, x0, y0, x1, y1, at, edges)
    for i in range(count - 1):
        middle = 0.5 * (at[i] + at[i + 1])
        if holds(corners, x0 + middle * (x1 - x0), y0 + middle * (y1 - y0)):
            return int(edges[i])
    return -1


@kernel
def _beside(corners: Array, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether the leg lies wholly to one side of the polygon's bounding box."""
    west = south = np.inf
    east = north = -np.inf
    for e in range(corners.shape[0]):
        west, east = min(west, corners[e, 0]), max(east, corners[e, 0])
        south, north = min(south, corners[e, 1]), max(north, corners[e, 1])
    return max(x0, x1) <= west or min(x0, x1) >= east or max(y0, y1) <= south or min(y0, y1) >= north


@kernel
def _crossings(corners: Array, x0: float, y0: float, x1: float, y1: float, at: Array, edges: Ints) -> int:
    """Write where on the leg, 0 to 1 in order, it begins, meets an edge or a corner, and ends.

    Returns how many places that are.
    """
    n, count = corners.shape[0], 0
    count = _insert(at, edges, count, 0.0, _nearest_edge(corners, x0, y0))
    count = _insert(at, edges, count, 1.0, 0)
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    for e in range(n):
        ax, ay, bx, by = _edge(corners, e)
        ex, ey = bx - ax, by - ay
        cross = dx * ey - dy * ex
        if cross != 0.0:
            t = ((ax - x0) * ey - (ay - y0) * ex) / cross
            s = ((ax - x0) * dy - (ay - y0) * dx) / cross
            if 0.0 < t < 1.0 and -1e-9 <= s <= 1.0 + 1e-9:
                count = _insert(at, edges, count, t, e)
        if length2 > 0.0:  # corners beside the leg, for legs along an edge
            t = ((ax - x0) * dx + (ay - y0) * dy) / length2
            if 0.0 < t < 1.0:
                count = _insert(at, edges, count, t, e)
    return count


@kernel
def _insert(at: Array, edges: Ints, count: int, t: float, edge: int) -> int:
    i = count
    while i > 0 and at[i - 1] > t:
        at[i], edges[i] = at[i - 1], edges[i - 1]
        i -= 1
    at[i], edges[i] = t, edge
    return count + 1


@kernel
def _edge(corners: Array, e: int) -> tuple[float, float, float, float]:
    """(east, north) of both ends of edge e."""
    following = e + 1 if e + 1 < corners.shape[0] else 0
    return corners[e, 0], corners[e, 1], corners[following, 0], corners[following, 1]


@kernel
def holds(corners: Array, x: float, y: float) -> bool:
    """Return whether (x, y) lies inside the polygon and not merely on its edge."""
    inside = False
    for e in range(corners.shape[0]):
        ax, ay, bx, by = _edge(corners, e)
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
    return inside and _edge_distance(corners, _nearest_edge(corners, x, y), x, y) > SLACK_M


@kernel
def _edge_distance(corners: Array, edge: int, x: float, y: float) -> float:
    ax, ay, bx, by = _edge(corners, edge)
    ex, ey = bx - ax, by - ay
    along = min(1.0, max(0.0, ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)))
    return float(np.hypot(x - ax - along * ex, y - ay - along * ey))


@kernel
def _nearest_edge(corners: Array, x: float, y: float) -> int:
    best, least = 0, np.inf
    for e in range(corners.shape[0]):
        away = _edge_distance(corners, e, x, y)
        if away < least:
            best, least = e, away
    return best


@kernel
def _slide(corners: Array, edge: int, x: float, y: float) -> tuple[float, float]:
    """From (x, y) back over the line of `edge`, to its outer side."""
    ax, ay, bx, by = _edge(corners, edge)
    length = np.hypot(bx - ax, by - ay)
    nx, ny = (by - ay) / length, (ax - bx) / length
    if holds(corners, 0.5 * (ax + bx) + 1e-6 * nx, 0.5 * (ay + by) + 1e-6 * ny):
        nx, ny = -nx, -ny
    short = MARGIN_M - (nx * (x - ax) + ny * (y - ay))
    return short * nx, short * ny
