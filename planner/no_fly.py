"""Areas over which no UAV may fly."""

from __future__ import annotations

from math import dist
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator
from shapely import Point as GeoPoint
from shapely import Polygon

from skyfolio.planner.parts import MAX_VERTICES, Placed, Point, PositionDeg, either, in_degrees


class NoFlyDisc(Placed):
    """A round area over which no UAV may fly; its edge may be touched. Metres."""

    model_config = ConfigDict(json_schema_extra=either(("center_m",), ("center_deg",)))

    kind: Literal["disc"] = "disc"
    center_m: Point
    radius_m: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1_000_000)]
    center_deg: PositionDeg | None = in_degrees("Its centre, degrees; may be given instead of `center_m`.")


class NoFlyPolygon(Placed):
    """A simple polygon over which no UAV may fly; its edge may be touched. Metres, in either order of rotation."""

    model_config = ConfigDict(json_schema_extra=either(("vertices_m",), ("vertices_deg",)))

    kind: Literal["polygon"] = "polygon"
    vertices_m: Annotated[tuple[Point, ...], Field(min_length=3, max_length=MAX_VERTICES)]
    vertices_deg: Annotated[tuple[PositionDeg, ...], Field(min_length=3, max_length=MAX_VERTICES)] | None = in_degrees(
        "Its outline, degrees; may be given instead of `vertices_m`."
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        outline = Polygon(self.vertices_m)
        if not outline.is_valid or outline.area == 0:
            raise ValueError("vertices_m: the outline must enclose an area and not cross itself")
        return self


NoFlyZone = Annotated[NoFlyDisc | NoFlyPolygon, Field(discriminator="kind")]


def zone_holds(zone: NoFlyDisc | NoFlyPolygon, point: Point) -> bool:
    """Return whether the point, metres east/north, lies strictly inside the zone."""
    if isinstance(zone, NoFlyDisc):
        return dist(zone.center_m, point) < zone.radius_m
    return bool(Polygon(zone.vertices_m).contains(GeoPoint(point)))
