"""A small plan around where vehicles stand, which a check uploads and flight tests fly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skyfolio.planner import Origin, Plan, Scenario
from skyfolio.planner.geometry import Point
from skyfolio.planner.plans import Summary
from skyfolio.planner.scenario import Uav, User

SLOT_S, ALTITUDE_M, SPEED_MPS, ROOM_M, APART_M = 5.0, 15.0, 4.0, 60.0, 4.0
SQUARE: tuple[Point, ...] = (
    *((0.0, 0.0), (0.0, 15.0), (0.0, 30.0), (0.0, 30.0)),
    *((12.0, 30.0), (24.0, 30.0), (24.0, 15.0), (24.0, 0.0)),
)
"""Metres east/north: north, a hover, east, and back south; legs of 12 and 15 m."""


def trial_plan(origin: Origin, paths_m: Mapping[str, Sequence[Point]], *, altitude_m: float = ALTITUDE_M) -> Plan:
    """Make a plan that flies these paths, one point in each slot; what its users get is not meant to be used.

    paths_m: for each UAV (n_slots, 2) metres east/north of the origin. altitude_m: above home. The area of the plan,
    and so its geofence, reaches ROOM_M beyond the paths.
    """
    uavs = list(paths_m)
    points = [point for path in paths_m.values() for point in path]
    slots = len(paths_m[uavs[0]])
    scenario = Scenario(
        origin=origin,
        area_m=(
            (min(east for east, _ in points) - ROOM_M, min(north for _, north in points) - ROOM_M),
            (max(east for east, _ in points) + ROOM_M, max(north for _, north in points) + ROOM_M),
        ),
        slots=slots,
        slot_duration_s=SLOT_S,
        altitude_m=altitude_m,
        min_separation_m=APART_M,
        uavs=tuple(Uav(id=uav, start_m=paths_m[uav][0], max_speed_mps=SPEED_MPS) for uav in uavs),
        users=(User(id="user-1", position_m=points[0]),),
    )
    return Plan(
        id="trial",
        method="by hand",
        scenario=scenario,
        trajectories_m={uav: list(path) for uav, path in paths_m.items()},
        association={"user-1": [uavs[0]] * slots},
        bandwidth_hz={"user-1": [scenario.uavs[0].bandwidth_hz] * slots},
        user_rates_bps={"user-1": [0.0] * slots},
        summary=Summary.steady(),
    )
