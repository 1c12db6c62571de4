"""Shapes of files, longitude and latitude, as the places of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, radians
from typing import Any

from shapely import LineString, MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry

from skyfolio.planner.scenario import PositionDeg

MARGIN_DEG = 0.001
"""An area that no file gives reaches this far beyond all users and UAVs: 111 m to the north and south, and as far to
the east and west."""


def polygons_of(shape: BaseGeometry) -> list[Polygon]:
    """Return the polygons that a shape consists of."""
    if isinstance(shape, Polygon):
        return [shape]
    return list(shape.geoms) if isinstance(shape, MultiPolygon) else []


def place_of(point: BaseGeometry) -> dict[str, float]:
    """Return where a point is."""
    assert isinstance(point, Point)  # noqa: S101 - `_misplaced` has looked
    return {"lat": point.y, "lon": point.x}


def places_of(shape: BaseGeometry) -> dict[str, Any]:
    """Return where a user is: a line has a place for each slot."""
    if isinstance(shape, LineString):
        return {"positions_deg": [{"lat": lat, "lon": lon} for lon, lat, *_ in shape.coords]}
    return {"position_deg": place_of(shape)}


def outline_of(polygon: Polygon) -> list[dict[str, float]]:
    """Return the corners of a polygon; a file repeats the first one at the end."""
    return [{"lat": lat, "lon": lon} for lon, lat, *_ in polygon.exterior.coords[:-1]]


def corners_of(polygon: Polygon) -> list[dict[str, float]] | None:
    """Return the corners south-west and north-east of a polygon that is a box along the parallels, otherwise None."""
    west, south, east, north = polygon.bounds
    corners = {(lon, lat) for lon, lat, *_ in polygon.exterior.coords}
    if len(polygon.exterior.coords) != 5 or corners != {(west, south), (west, north), (east, south), (east, north)}:
        return None
    return [{"lat": south, "lon": west}, {"lat": north, "lon": east}]


def around(places: Sequence[PositionDeg]) -> list[dict[str, float]]:
    """Return the corners of a box around these places, with a margin."""
    lats, lons = [place.lat for place in places], [place.lon for place in places]
    aside = MARGIN_DEG / max(cos(radians(max(map(abs, lats)))), 0.05)
    low = {"lat": max(min(lats) - MARGIN_DEG, -90.0), "lon": max(min(lons) - aside, -180.0)}
    return [low, {"lat": min(max(lats) + MARGIN_DEG, 90.0), "lon": min(max(lons) + aside, 180.0)}]
