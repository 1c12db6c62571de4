"""Random scenarios over hills, with starts up to 300 m of height apart, and a second, coarser judge of their plans.

`judged` looks at places a metre apart along every leg and way home. It finds less than `violations` does, and cannot
have a mistake in common with it: it knows nothing of cells and quadratics.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from skyfolio.planner import Plan, Scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.terrain import Terrain

MARGIN_M = 60.0
RELIEF_M = 300.0
STEP_M = 1.0
ROUNDING_M = 1e-3


def over_hills(level: Scenario, seed: int) -> Scenario:
    """Return a scenario on random hills; with some seeds altitudes are chosen, climbs slow, or clearances wide.

    Where the last slot must end in another place than it begins, that is left out: not every valley can be crossed.
    """
    rng = np.random.default_rng(seed)
    chosen, slow, wide = rng.random(3) < 0.4
    clearance = float(rng.choice([15.0, 40.0] if wide else [20.0, 30.0]))
    limits = {"altitude_min_m": clearance, "altitude_max_m": float(rng.uniform(60.0, 200.0))} if chosen else {}
    climb = {"max_climb_mps": 0.5} if slow else {}
    uavs = tuple(uav.model_copy(update=climb) for uav in level.uavs)
    return level.with_changes(uavs=uavs, terrain=hills(level, rng), clearance_m=clearance, **limits)


def hills(scenario: Scenario, rng: np.random.Generator) -> Terrain:
    """Return hills and rough ground around a scenario's area, up to 300 m high."""
    low = np.array(scenario.area_m[0]) - MARGIN_M
    size = np.array(scenario.area_m[1]) + MARGIN_M - low
    spacing = float(rng.uniform(20.0, 60.0))
    columns, rows = np.ceil(size / spacing).astype(int) + 1
    east, north = np.meshgrid(np.arange(columns) * spacing, np.arange(rows) * spacing)
    heights = rng.uniform(0.0, 8.0, size=east.shape)
    for _ in range(int(rng.integers(1, 6))):
        centre, width = rng.uniform((0.0, 0.0), size), float(rng.uniform(40.0, 250.0))
        away2 = (east - centre[0]) ** 2 + (north - centre[1]) ** 2
        heights += rng.uniform(20.0, RELIEF_M) * np.exp(-away2 / (2 * width**2))
    heights *= min(1.0, RELIEF_M / float(np.ptp(heights)))
    heights += float(rng.uniform(0.0, 1500.0))
    return Terrain(
        south_west_m=(float(low[0]), float(low[1])),
        spacing_m=spacing,
        heights_m=tuple(map(tuple, np.round(heights, 2).tolist())),
    )


def judged(plan: Plan) -> list[str]:
    """Return where a plan comes too near to the ground at places a metre apart on its legs and ways home."""
    scenario, terrain = plan.scenario, plan.scenario.terrain
    if terrain is None or plan.altitudes_m is None:
        return ["it has no altitudes"]
    found = []
    for uav in scenario.uavs:
        flown = scenario.last_slot(uav) + 1
        rows = zip(plan.trajectories_m[uav.id][:flown], plan.altitudes_m[uav.id][:flown], strict=True)
        for n, (here, there) in enumerate(pairwise(np.array([(*place, up) for place, up in rows]))):
            turns = _along(here, there)
            home = uav.home_m or uav.start_m
            ways = [turns, *(_along(turn, np.array([*home, turn[2]])) for turn in turns[:: max(1, len(turns) // 4)])]
            places = np.concatenate(ways)
            margin = float((places[:, 2] - terrain_heights(terrain, places[:, :2])).min())
            if margin < (scenario.clearance_m or 0.0) - ROUNDING_M:
                found.append(f"{uav.id} slot {n}: {margin:.3f} m over the ground")
    return found


def terrain_heights(terrain: Terrain, places_m: Array) -> Array:
    """Return the ground at places (n, 2), by weighing the four heights around each: (n,) metres."""
    heights = np.array(terrain.heights_m)
    cells = (places_m - np.array(terrain.south_west_m)) / terrain.spacing_m
    cells = np.clip(cells, 0.0, np.array(heights.shape[::-1]) - 1.0)
    total = np.zeros(len(cells))
    low = np.minimum(np.floor(cells).astype(int), np.array(heights.shape[::-1]) - 2)
    for right in (0, 1):
        for up in (0, 1):
            weight = np.abs(1 - right - (cells[:, 0] - low[:, 0])) * np.abs(1 - up - (cells[:, 1] - low[:, 1]))
            total += weight * heights[low[:, 1] + up, low[:, 0] + right]
    return total


def _along(here: Array, there: Array) -> Array:
    """Return places from one to the other, (n, 3) metres, at most `STEP_M` apart over ground."""
    count = int(np.ceil(np.hypot(*(there - here)[:2]) / STEP_M)) + 1
    shares: Array = np.linspace(0.0, 1.0, count + 1)[:, None]
    return here + shares * (there - here)
