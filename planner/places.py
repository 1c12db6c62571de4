"""Places in degrees beside places in metres: a scenario may be given in either, keeps both, and is planned in metres.

A place is converted once, where it enters, and rounded to a micrometre, so that metres of up to six decimals survive a
way through degrees to the bit. Edges between places are straight in metres east/north. What is given in both forms must
be the same place within a centimetre, about what 1e-7 degrees are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pymap3d import geodetic2enu
from pymap3d.haversine import anglesep
from shapely import Polygon, box, union_all
from shapely.geometry.base import BaseGeometry

from skyfolio.planner.arrays import Array
from skyfolio.planner.parts import Origin, Point, PositionDeg

AGREE_M = 0.01
"""The two forms of one place may be this far apart."""
SLIVER_M = 0.25
"""Parts of `area_m` outside of a polygon that are at most twice as wide are not closed off: no UAV flies so exactly,
and a rectangle that was drawn along another meridian would get four such zones."""
LARGEST_M = 100_000.0
"""A flat frame is no longer honest beyond: places may lie this far from the origin, and apart in either direction."""
_SUNKEN_M = -10_000.0
"""A place this far below the plane at the origin is on another side of the Earth: 350 km away or more."""
_DECIMALS_M, _DECIMALS_DEG = 6, 7
_EARTH_KM = 6371.0
Parts = Mapping[str, tuple[str, ...]]
OF_SCENARIO: Parts = {
    "users": ("position", "positions"),
    "uavs": ("start", "end", "home"),
    "no_fly": ("center", "vertices"),
    "rally_points": ("position",),
}
"""Lists of parts that have places, and what these are called without their unit."""
_DEGREES = TypeAdapter(tuple[PositionDeg, ...])

Metres = tuple[float, float]


class Twin(NamedTuple):
    """One place, or the outline of one zone, of a scenario: its field without the unit, and both its forms."""

    field: str
    metres: Point | Sequence[Point] | None
    degrees: PositionDeg | Sequence[PositionDeg] | None


class _Given(NamedTuple):
    """What is given in degrees: where it is found in the raw scenario, and whether it has no metres yet."""

    path: tuple[str, int, str] | tuple[str]
    places: tuple[PositionDeg, ...]
    single: bool
    alone: bool

    @property
    def field(self) -> str:
        return ".".join(map(str, self.path)) + "_deg"


def with_metres(given: Any, parts: Parts = OF_SCENARIO) -> Any:
    """Return a raw scenario, or other raw parts, with metres for each place that has degrees alone, and with an origin.

    What has no place in degrees is returned as it is; so is what is malformed: its own rule says what is wrong.
    Raises ValueError, the message naming the field, for places too far apart or across the 180th meridian.
    """
    if not isinstance(given, Mapping):
        return given
    found = list(_found(given, parts))
    if not found:
        return given
    named = [(one.field, place) for one in found for place in one.places]
    require_one_region(named)
    raw = {**given, **{part: [_copied(row) for row in given[part]] for part in parts if _is_list(given.get(part))}}
    if raw.get("origin") is None:
        _require_no_metres(raw, parts)
        raw["origin"] = chosen_origin(place for _, place in named)
    try:
        origin = Origin.model_validate(raw["origin"])
    except ValidationError:
        return raw  # the same rule is broken, and told, where the scenario's own fields are validated
    alone = [one for one in found if one.alone]
    places = [_corners_or_outline(one) if one.path == ("area",) else one.places for one in alone]
    for one, metres in zip(alone, _all_in_metres(origin, [one.field for one in alone], places), strict=True):
        _put(raw, one, metres)
    return raw


def chosen_origin(places: Iterable[PositionDeg]) -> Origin:
    """Return the middle of the places' bounding box as an origin, degrees."""
    degrees = np.array([(place.lat, place.lon) for place in places])
    lat, lon = ((degrees.min(axis=0) + degrees.max(axis=0)) / 2).round(_DECIMALS_DEG).tolist()
    return Origin(lat_deg=lat, lon_deg=lon)


def require_one_region(named: Sequence[tuple[str, PositionDeg]]) -> None:
    """Check that places lie within 100 km and on one side of the 180th meridian. Raises ValueError naming two."""
    degrees = np.array([(place.lat, place.lon) for _, place in named])
    (south, west), (north, east) = degrees.argmin(axis=0).tolist(), degrees.argmax(axis=0).tolist()
    if degrees[east, 1] - degrees[west, 1] > 180:
        raise ValueError(
            f"{named[east][0]}: it and {named[west][0]} lie on both sides of the 180th meridian, where longitudes "
            "jump; such a region cannot be planned"
        )
    for one, other in ((south, north), (west, east)):
        away_km = _apart_km(named[one][1], named[other][1])
        if away_km * 1000 > LARGEST_M:
            raise ValueError(
                f"{named[other][0]}: it is {away_km:,.0f} km from {named[one][0]}; places may be at most "
                f"{LARGEST_M / 1000:.0f} km apart"
            )


def require_agreement(origin: Origin, twins: Iterable[Twin]) -> None:
    """Check that what has metres and degrees is the same place within 1 cm. Raises ValueError naming the field."""
    both = [(twin, twin.degrees) for twin in twins if twin.degrees is not None]
    fields = [f"{twin.field}_deg" for twin, _ in both]
    degrees = [(given,) if isinstance(given, PositionDeg) else given for _, given in both]
    for (twin, _), found in zip(both, _all_in_metres(origin, fields, degrees), strict=True):
        metres = np.array(twin.metres if twin.metres is not None else [], dtype=float).reshape(-1, 2)
        if len(metres) != len(found):
            raise ValueError(f"{twin.field}_m: it must hold the same places as {twin.field}_deg, or be left out")
        apart = np.hypot(*(found - metres).T)
        if apart.max() > AGREE_M:
            raise ValueError(
                f"{twin.field}_m: it is {apart.max():.3g} m from {twin.field}_deg; give one of them, or the same place"
            )


def require_closed_off(
    origin: Origin, area_deg: Sequence[PositionDeg], area_m: tuple[Point, Point], outlines_m: Iterable[Sequence[Point]]
) -> None:
    """Check that the flying area in metres is the one in degrees, less what no-fly polygons close off.

    outlines_m: of the no-fly polygons, metres. Raises ValueError naming the field.
    """
    corners = in_metres(origin, four_corners(area_deg) if len(area_deg) == 2 else area_deg, "area_deg")
    bounds = _inner_box(corners) if len(area_deg) == 2 else _around(corners)
    if np.abs(np.array(bounds) - np.array(area_m)).max() > AGREE_M:
        raise ValueError(f"area_m: {area_m} is not the area of area_deg, which is {bounds}; give one of them")
    if len(area_deg) > 2:
        closed = union_all([Polygon(outline).buffer(AGREE_M) for outline in outlines_m])
        if _thick_parts(_outside(corners).difference(closed)):
            raise ValueError(
                "no_fly: it must close off what is in area_m and outside of area_deg; leave area_m out, and it is done"
            )


def closings_m(origin: Origin, area_deg: Sequence[PositionDeg]) -> list[list[Metres]]:
    """Return the outlines, metres, of what has to be closed off around the area within the rectangle `area_m`."""
    return [] if len(area_deg) == 2 else _usable(in_metres(origin, area_deg, "area_deg"), corners=False)[1]


def in_metres(origin: Origin, places: Sequence[PositionDeg], fields: str | Sequence[str]) -> Array:
    """Return places as (n, 2) metres east/north of the origin, to a micrometre. Raises ValueError if too far."""
    named = [fields] * len(places) if isinstance(fields, str) else fields
    lat_deg, lon_deg = np.array([(place.lat, place.lon) for place in places], dtype=float).reshape(-1, 2).T
    across = np.abs(lon_deg - origin.lon_deg) > 180
    if across.any():
        field = named[int(across.argmax())]
        raise ValueError(f"{field}: it lies on the other side of the 180th meridian from the origin")
    east, north, up = geodetic2enu(lat_deg, lon_deg, np.zeros(len(places)), origin.lat_deg, origin.lon_deg, 0.0)
    far = (np.maximum(np.abs(east), np.abs(north)) > LARGEST_M) | (up < _SUNKEN_M)
    if far.any():
        field = named[int(far.argmax())]
        away_km = _apart_km(places[int(far.argmax())], PositionDeg(lat=origin.lat_deg, lon=origin.lon_deg))
        raise ValueError(
            f"{field}: it is {away_km:,.0f} km from the origin; at most {LARGEST_M / 1000:.0f} km are planned"
        )
    metres: Array = np.round(np.stack([east, north], axis=-1), _DECIMALS_M) + 0.0  # no minus zero
    return metres


def _all_in_metres(origin: Origin, fields: Sequence[str], groups: Sequence[Sequence[PositionDeg]]) -> list[Array]:
    """Return the metres of groups of places, each of one field, in about the time of one."""
    if not groups:
        return []
    named = [field for field, group in zip(fields, groups, strict=True) for _ in group]
    metres = in_metres(origin, [place for group in groups for place in group], named)
    return np.split(metres, np.cumsum([len(group) for group in groups])[:-1])


# --- finding and filling in ---


def _found(given: Mapping[str, Any], parts: Parts) -> Iterator[_Given]:
    """Yield what a raw scenario has in degrees, as far as it is well-formed."""
    for part, names in parts.items():
        rows = given.get(part)
        for index, row in enumerate(rows if isinstance(rows, list | tuple) else ()):
            if isinstance(row, Mapping):
                for name in names:
                    yield from _parsed((part, index, name), row)
    yield from _parsed(("area",), given)


def _parsed(path: tuple[str, int, str] | tuple[str], row: Mapping[str, Any]) -> Iterator[_Given]:
    name = path[-1]
    raw = row.get(f"{name}_deg")
    if raw is None:
        return
    single = not isinstance(raw, list | tuple)
    try:
        places = _DEGREES.validate_python((raw,) if single else raw)
    except ValidationError:
        return  # the same rule is broken, and told, where the part's own fields are validated
    if places:
        yield _Given(path, places, single, row.get(f"{name}_m") is None)


def _put(raw: dict[str, Any], one: _Given, metres: Array) -> None:
    if len(one.path) == 1:
        box_m, closed = _usable(metres, corners=len(one.places) == 2)
        raw["area_m"] = box_m
        raw["no_fly"] = [
            *(raw.get("no_fly") or ()),
            *({"kind": "polygon", "vertices_m": outline} for outline in closed),
        ]
        return
    part, index, name = one.path
    points = list(map(tuple, metres.tolist()))
    raw[part][index][f"{name}_m"] = points[0] if one.single else points


def _require_no_metres(raw: Mapping[str, Any], parts: Parts) -> None:
    for part, names in parts.items():
        for index, row in enumerate(raw.get(part) or ()):
            for name in names:
                held = row.get(f"{name}_m") if isinstance(row, Mapping) else getattr(row, f"{name}_m", None)
                if held is not None:
                    raise ValueError(f"origin: it must be given, since {part}.{index}.{name}_m is in metres from it")
    if raw.get("area_m") is not None:
        raise ValueError("origin: it must be given, since area_m is in metres from it")


def _is_list(rows: Any) -> bool:
    return isinstance(rows, list | tuple)


def _copied(row: Any) -> Any:
    return dict(row) if isinstance(row, Mapping) else row


# --- areas ---


def _corners_or_outline(area: _Given) -> Sequence[PositionDeg]:
    if len(area.places) > 2:
        return area.places
    low, high = area.places
    if not (low.lat < high.lat and low.lon < high.lon):
        raise ValueError("area_deg: two corners must be the south-western one and the north-eastern one")
    return four_corners(area.places)


def four_corners(corners: Sequence[PositionDeg]) -> list[PositionDeg]:
    """Return all corners of a box from the south-western one against the clock; corners: SW and NE."""
    low, high = corners
    between = PositionDeg(lat=low.lat, lon=high.lon), PositionDeg(lat=high.lat, lon=low.lon)
    return [low, between[0], high, between[1]]


def _usable(outline_m: Array, *, corners: bool) -> tuple[tuple[Metres, Metres], list[list[Metres]]]:
    """Return the rectangle to fly in, metres, and the outlines of what of it is outside of the area."""
    if corners:
        return _inner_box(outline_m), []
    if not Polygon(outline_m).is_valid:
        raise ValueError("area_deg: the outline must enclose an area and not cross itself")
    return _around(outline_m), [list(part.exterior.coords)[:-1] for part in _thick_parts(_outside(outline_m))]


def _inner_box(corners_m: Array) -> tuple[Metres, Metres]:
    """Return the rectangle inside four corners, counted from the south-western one against the clock."""
    (west, south), (east, south_east), (east_north, north), (west_north, north_west) = corners_m.tolist()
    return (max(west, west_north), max(south, south_east)), (min(east, east_north), min(north, north_west))


def _around(outline_m: Array) -> tuple[Metres, Metres]:
    (west, south), (east, north) = outline_m.min(axis=0).tolist(), outline_m.max(axis=0).tolist()
    return (west, south), (east, north)


def _outside(outline_m: Array) -> BaseGeometry:
    outline = Polygon(outline_m)
    return box(*outline.bounds).difference(outline)


def _thick_parts(rest: BaseGeometry) -> list[Polygon]:
    parts = getattr(rest, "geoms", [rest])
    return [part for part in parts if isinstance(part, Polygon) and not part.buffer(-SLIVER_M).is_empty]


def _apart_km(a: PositionDeg, b: PositionDeg) -> float:
    return float(np.radians(anglesep(a.lon, a.lat, b.lon, b.lat))) * _EARTH_KM
