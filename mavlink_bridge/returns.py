"""Are the straight ways home safe to be flown at the same time?"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import hypot

from skyfolio.mavlink_bridge.errors import ReturnPathsTooClose
from skyfolio.planner.plans import Plan

Point = tuple[float, float]
Segment = tuple[Point, Point]


def check_return_paths(plan: Plan, homes_m: Mapping[str, Point]) -> None:
    """Raise ReturnPathsTooClose if two UAVs could meet on the straight lines from their last points to their homes.

    homes_m: uav id -> (east, north) metres from the origin. All fly home at once and at one altitude, at speeds
    nobody promised, so the whole lines must stay `min_separation_m` apart, not only the points reached together.
    """
    required_m = plan.scenario.min_separation_m
    ways = {uav_id: (path[-1], homes_m[uav_id]) for uav_id, path in plan.trajectories_m.items()}
    for (first, way_a), (second, way_b) in combinations(ways.items(), 2):
        apart_m = segment_distance_m(way_a, way_b)
        if apart_m < required_m:
            raise ReturnPathsTooClose(first, second, apart_m, required_m)


def segment_distance_m(a: Segment, b: Segment) -> float:
    """Least distance in metres between two straight segments in the plane, 0 where they cross."""
    if _cross(a, b):
        return 0.0
    return min(_to_segment(a[0], b), _to_segment(a[1], b), _to_segment(b[0], a), _to_segment(b[1], a))


def _cross(a: Segment, b: Segment) -> bool:
    return _side(a, b[0]) * _side(a, b[1]) < 0 and _side(b, a[0]) * _side(b, a[1]) < 0


def _side(line: Segment, point: Point) -> float:
    (x0, y0), (x1, y1) = line
    return (x1 - x0) * (point[1] - y0) - (y1 - y0) * (point[0] - x0)


def _to_segment(point: Point, segment: Segment) -> float:
    (x0, y0), (x1, y1) = segment
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    along = 0.0 if length2 == 0 else ((point[0] - x0) * dx + (point[1] - y0) * dy) / length2
    along = min(1.0, max(0.0, along))
    return hypot(point[0] - x0 - along * dx, point[1] - y0 - along * dy)
