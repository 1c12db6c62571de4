"""Where returns end, and whether the straight ways there can be flown at the same time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import dist

from skyfolio.mavlink_bridge.errors import ReturnPathsTooClose
from skyfolio.mavlink_bridge.plane import segment_distances_m
from skyfolio.planner.geometry import Point
from skyfolio.planner.plans import Plan


def return_point_m(at_m: Point, home_m: Point, rally_m: Sequence[Point]) -> Point:
    """Return where a return from `at_m` ends: at home, or at a rally point that is nearer; metres east/north.

    Both autopilots choose so (RTL_TYPE 0 of PX4; ArduPilot within RALLY_LIMIT_KM).
    """
    return min((home_m, *rally_m), key=lambda place_m: dist(at_m, place_m))


def check_return_paths(plan: Plan, homes_m: Mapping[str, Point]) -> None:
    """Raise ReturnPathsTooClose if two UAVs could meet on the straight lines from their last points to where they land.

    That is home or the nearest of the scenario's rally points: two that would land at the same one are refused.

    homes_m: uav id -> (east, north) metres from the origin. All fly home at once and at one altitude, at speeds that
    are not known, so the whole lines must stay `min_separation_m` apart, not only the points reached together.
    """
    required_m = plan.scenario.min_separation_m
    ways = {
        uav_id: (path[-1], return_point_m(path[-1], homes_m[uav_id], plan.scenario.rally_m))
        for uav_id, path in plan.trajectories_m.items()
    }
    pairs = list(combinations(ways, 2))
    apart_m = segment_distances_m([ways[first] for first, _ in pairs], [ways[second] for _, second in pairs])
    for (first, second), distance_m in zip(pairs, apart_m.tolist(), strict=True):
        if distance_m < required_m:
            raise ReturnPathsTooClose(first, second, distance_m, required_m)
