"""Check that the straight ways home can be flown at the same time."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

from skyfolio.mavlink_bridge.errors import ReturnPathsTooClose
from skyfolio.mavlink_bridge.plane import segment_distances_m
from skyfolio.planner.geometry import Point
from skyfolio.planner.plans import Plan


def check_return_paths(plan: Plan, homes_m: Mapping[str, Point]) -> None:
    """Raise ReturnPathsTooClose if two UAVs could meet on the straight lines from their last points to home.

    homes_m: uav id -> (east, north) metres from the origin. All fly home at once and at one altitude, at speeds that
    are not known, so the whole lines must stay `min_separation_m` apart, not only the points reached together.
    """
    required_m = plan.scenario.min_separation_m
    ways = {uav_id: (path[-1], homes_m[uav_id]) for uav_id, path in plan.trajectories_m.items()}
    pairs = list(combinations(ways, 2))
    apart_m = segment_distances_m([ways[first] for first, _ in pairs], [ways[second] for _, second in pairs])
    for (first, second), distance_m in zip(pairs, apart_m.tolist(), strict=True):
        if distance_m < required_m:
            raise ReturnPathsTooClose(first, second, distance_m, required_m)
