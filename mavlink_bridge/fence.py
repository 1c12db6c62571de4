"""Geofence and rally points of a plan as mission items of types 1 and 2."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skyfolio.mavlink_bridge.e7 import to_e7
from skyfolio.mavlink_bridge.items import Command, Frame, MissionItem
from skyfolio.planner.geodesy import east_north_to_geodetic
from skyfolio.planner.geometry import Point
from skyfolio.planner.scenario import Scenario

MARGIN_M = 20.0
"""The fence stands this far outside of the area: a corner flown wide should not end a mission."""


def fence_items(scenario: Scenario, *, margin_m: float = MARGIN_M) -> tuple[MissionItem, ...]:
    """Return the plan's area, widened by `margin_m`, as an inclusion polygon (MAV_CMD 5001, counter-clockwise)."""
    (west, south), (east, north) = scenario.area_m
    corners = [
        (west - margin_m, south - margin_m),
        (east + margin_m, south - margin_m),
        (east + margin_m, north + margin_m),
        (west - margin_m, north + margin_m),
    ]
    return _items(
        scenario,
        corners,
        lambda seq, x, y: MissionItem(
            seq=seq,
            frame=Frame.GLOBAL,
            command=Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            param1=float(len(corners)),
            x=x,
            y=y,
        ),
    )


def rally_items(scenario: Scenario, points_m: Sequence[Point], altitude_m: float) -> tuple[MissionItem, ...]:
    """Return places to return to instead of home (MAV_CMD 5100), metres east/north of the origin and above home."""
    return _items(
        scenario,
        points_m,
        lambda seq, x, y: MissionItem(
            seq=seq, frame=Frame.GLOBAL_RELATIVE_ALT, command=Command.NAV_RALLY_POINT, x=x, y=y, z=altitude_m
        ),
    )


def _items(
    scenario: Scenario, points_m: Sequence[Point], item: Callable[[int, int, int], MissionItem]
) -> tuple[MissionItem, ...]:
    items = []
    for seq, point in enumerate(points_m):
        lat_deg, lon_deg = east_north_to_geodetic(scenario.origin, *point)
        items.append(item(seq, to_e7(lat_deg), to_e7(lon_deg)))
    return tuple(items)
