"""Features of files, put together as one scenario."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field, ValidationError
from shapely import LineString, MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry

from skyfolio.api.common.validation import broken_rules
from skyfolio.api.places.faults import Fault, FaultyFilesError
from skyfolio.api.places.files import Feature, Kind
from skyfolio.api.places.properties import NESTED, VELOCITY
from skyfolio.api.places.shapes import around, corners_of, outline_of, place_of, places_of, polygons_of
from skyfolio.planner import Origin, Scenario, Utility
from skyfolio.planner.channels.kinds import AnyChannel
from skyfolio.planner.places import require_one_region
from skyfolio.planner.scenario import Altitude, Frozen, PositionDeg, Wind

DEFAULTS: Mapping[str, Any] = {"slots": 20, "slot_duration_s": 5.0, "altitude_m": 60.0, "min_separation_m": 4.0}
"""Those of the letter."""
OVER_GROUND = ("clearance_m", "altitude_min_m", "altitude_max_m")
"""Settings that count from the ground, which is read once the region is known."""
LISTS: Mapping[Kind, str] = {"user": "users", "uav": "uavs", "no_fly": "no_fly", "rally_point": "rally_points"}
_SHAPES: Mapping[Kind, tuple[type[BaseGeometry], ...]] = {
    "user": (Point, LineString), "uav": (Point,), "rally_point": (Point,),
}  # fmt: skip
"""A user that is a line has a place for each slot."""
_PART = re.compile(r"\b(?:users|uavs|no_fly|rally_points)\.\d+(?:\.\w+)*|\barea_deg\b")
_SINGULAR = {"users": "user", "uavs": "UAV"}


class ScenarioSettings(Frozen):
    """What of a scenario is no place; each is optional, and as in a scenario."""

    origin: Origin | None = None
    slots: Annotated[int, Field(strict=True, ge=1, le=100_000)] | None = None
    slot_duration_s: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=3600)] | None = None
    altitude_m: Altitude | None = None
    min_separation_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10_000)] | None = None
    channel: AnyChannel | None = None
    utility: Utility | None = None
    wind: Wind | None = None
    clearance_m: Altitude | None = None
    altitude_min_m: Altitude | None = None
    altitude_max_m: Altitude | None = None


class Assembly:
    """A scenario in the making. `faults`: features that cannot be part of one; `notes`: what was chosen, in words."""

    def __init__(self, features: Sequence[Feature], base: Scenario | None) -> None:
        self.faults: list[Fault] = []
        self.notes: list[str] = []
        self._base = base
        self._raw: dict[str, Any] = {"users": [], "uavs": [], "no_fly": [], "rally_points": []}
        self._origins: dict[str, Feature] = {}
        self._ids: dict[tuple[Kind, str], Feature] = {}
        for feature in features:
            self._add(feature)

    @property
    def stands_alone(self) -> bool:
        """Return whether the files say both whom to serve and with what."""
        return bool(self._raw["users"] and self._raw["uavs"])

    def scenario(self, settings: Mapping[str, Any]) -> Scenario:
        """Return the scenario. Raises FaultyFilesError that names file and row for each rule that is broken."""
        raw = {**self._raw, **self._settings(settings)}
        if self._base is not None and not self.stands_alone:
            raw = {**raw, **self._kept(self._base)}
        self._require("users", raw)
        self._require("uavs", raw)
        self._number(raw)
        if "area_deg" not in raw and "area_m" not in raw:
            raw["area_deg"] = around(self._one_region(raw))
            self.notes.append("area: no file has one; it reaches 0.001 degrees of latitude beyond all users and UAVs")
        try:
            made = Scenario.model_validate(raw)
        except ValidationError as error:
            raise FaultyFilesError([self._named(row) for row in broken_rules(error.errors(), ())]) from error
        if "origin" not in raw:
            origin = made.origin
            self.notes.insert(0, f"origin: chosen amid all places, {origin.lat_deg}, {origin.lon_deg} degrees")
        return made

    # --- features ---

    def _add(self, feature: Feature) -> None:
        wrong = next(_misplaced(feature), None)
        if wrong is not None:
            self.faults.append(wrong)
            return
        if feature.kind == "area":
            self._add_area(feature)
            return
        if feature.kind in {"user", "uav"} and "id" in feature.values:
            self._require_new_id(feature, str(feature.values["id"]))
        for part in _parts(feature):
            rows = self._raw[LISTS[feature.kind]]
            self._origins[f"{LISTS[feature.kind]}.{len(rows)}"] = feature
            rows.append(part)

    def _add_area(self, feature: Feature) -> None:
        if "area_deg" in self._raw:
            self.faults.append(feature.fault("area", f"there is an area already, {self._origins['area_deg'].label}"))
            return
        self._origins["area_deg"] = feature
        [outline] = polygons_of(feature.geometry)
        self._raw["area_deg"] = corners_of(outline) or outline_of(outline)

    def _require_new_id(self, feature: Feature, name: str) -> None:
        known = self._ids.setdefault((feature.kind, name), feature)
        if known is not feature:
            self.faults.append(feature.fault("unique", f"{name!r} is already the id of {known.label}", "id"))

    def _number(self, raw: dict[str, Any]) -> None:
        """Give an id to what has none: its kind and the next number."""
        for kind in ("user", "uav"):
            rows = raw[LISTS[kind]]
            taken = {row["id"] for row in rows if "id" in row}
            free = (name for n in range(1, len(rows) + len(taken) + 1) if (name := f"{kind}-{n}") not in taken)
            made = [row.update(id=next(free)) for row in rows if "id" not in row]
            if made:
                self.notes.append(f"id: {len(made)} of {len(rows)} {LISTS[kind]} had none, and are numbered")

    # --- what the files do not say ---

    def _settings(self, given: Mapping[str, Any]) -> dict[str, Any]:
        names = ScenarioSettings.model_fields.keys() - {"origin", *OVER_GROUND}
        kept = {} if self._base is None else {name: getattr(self._base, name) for name in names}
        known = {name: value for name, value in kept.items() if value is not None}
        chosen = {name: value for name, value in DEFAULTS.items() if name not in known and name not in given}
        if chosen:
            values = ", ".join(f"{name} {value:g}" for name, value in chosen.items())
            self.notes.append(f"settings: none given, so these are the letter's: {values}")
        return {**chosen, **known, **given}

    def _kept(self, base: Scenario) -> dict[str, Any]:
        """Return the places of the base that stay. Zones stay with its area, from which some of them may come."""
        fields = base.model_dump(mode="json")
        kept: dict[str, Any] = {"origin": fields["origin"]}
        for part in ("users", "uavs", "rally_points"):
            if not self._raw[part] and part in fields:
                kept[part] = fields[part]
        if "area_deg" not in self._raw:
            own_zones = bool(self._raw["no_fly"])
            names = ["area_m", "area_deg", "no_fly"]
            if own_zones:
                names = ["area_deg"] if "area_deg" in fields else ["area_m"]
            kept |= {name: fields[name] for name in names if name in fields}
        self.notes.append(f"base: kept {', '.join(sorted(kept))} of the base scenario")
        return kept

    def _require(self, part: str, raw: Mapping[str, Any]) -> None:
        if not raw[part]:
            message = f"no file has a {_SINGULAR[part]}, and there is no base scenario to take them from"
            raise FaultyFilesError([Fault(file="files", rule="missing", message=message, column=part)])

    def _one_region(self, raw: Mapping[str, Any]) -> list[PositionDeg]:
        """Return the places of all users and UAVs. Raises FaultyFilesError if they do not lie in one region."""
        named = [
            (f"{part}.{index}.{name}", PositionDeg.model_validate(place))
            for part, names in (("users", ("position_deg", "positions_deg")), ("uavs", ("start_deg", "end_deg")))
            for index, row in enumerate(raw[part])
            for name in names
            if name in row
            for place in (row[name] if isinstance(row[name], list) else [row[name]])
        ]
        try:
            require_one_region(named)
        except ValueError as error:
            field, _, message = str(error).partition(": ")
            fault = self._named({"field": field, "rule": "region", "message": message})
            raise FaultyFilesError([fault]) from error
        return [place for _, place in named]

    # --- faults ---

    def _named(self, row: Mapping[str, str]) -> Fault:
        """Return a broken rule of the scenario as a fault of the file and row that it comes from."""
        message = _PART.sub(self._label, row["message"])
        field = row["field"]
        part = field if field in self._origins else ".".join(field.split(".")[:2])
        feature = self._origins.get(part) or self._origins.get(field.split(".")[0])
        if feature is None:
            return Fault(file="scenario", rule=row["rule"], message=message, column=field)
        name = field.rpartition(".")[2]
        return feature.fault(row["rule"], message, name)

    def _label(self, found: re.Match[str]) -> str:
        part = ".".join(found[0].split(".")[:2])
        return self._origins[part].label if part in self._origins else found[0]


def _misplaced(feature: Feature) -> Iterator[Fault]:
    """Yield what is wrong with the geometry of a feature."""
    shape, kind = feature.geometry, feature.kind
    bounds = shape.bounds
    if kind == "uav":
        yield from _wrong_end(feature)
    if kind == "user":
        yield from _wrong_velocity(feature)
    if kind in _SHAPES and not isinstance(shape, _SHAPES[kind]):
        known = " or ".join(f"a {one.__name__}" for one in _SHAPES[kind])
        yield feature.fault("geometry", f"a {kind} must be {known}, not a {shape.geom_type}", "lat")
    elif kind == "no_fly" and isinstance(shape, Point) and "radius_m" not in feature.values:
        yield feature.fault("geometry", "a no-fly zone that is a Point must have a radius_m", "radius_m")
    elif kind in {"no_fly", "area"} and not isinstance(shape, Polygon | MultiPolygon | Point):
        yield feature.fault("geometry", f"it must be a Polygon, not a {shape.geom_type}", "lat")
    elif kind == "area" and len(polygons_of(shape)) != 1:
        yield feature.fault("geometry", "an area must be one Polygon", "lat")
    elif any(polygon.interiors for polygon in polygons_of(shape)):
        yield feature.fault("geometry", "a polygon must have no holes; split it, or make the hole a no-fly zone", "lat")
    elif not (bounds[1] >= -90 and bounds[3] <= 90):
        worst = bounds[1] if bounds[1] < -90 else bounds[3]
        hint = "; are latitude and longitude swapped?" if abs(worst) <= 180 else ""
        yield feature.fault("range", f"latitude {worst:g} must lie in -90..90 degrees{hint}", "lat")
    elif not (bounds[0] >= -180 and bounds[2] <= 180):
        worst = bounds[0] if bounds[0] < -180 else bounds[2]
        yield feature.fault("range", f"longitude {worst:g} must lie in -180..180 degrees", "lon")


def _wrong_end(feature: Feature) -> Iterator[Fault]:
    """Yield what is wrong with where a UAV must end."""
    limits = {"end_lat_deg": 90, "end_lon_deg": 180}
    given = {name: feature.values[name] for name in limits if name in feature.values}
    for name, value in given.items():
        if not abs(value) <= limits[name]:
            yield feature.fault("range", f"{value:g} must lie in -{limits[name]}..{limits[name]} degrees", name)
    if len(given) == 1:
        yield feature.fault("end", "end_lat_deg and end_lon_deg belong together", next(iter(given)))


def _wrong_velocity(feature: Feature) -> Iterator[Fault]:
    """Yield what is wrong with how a user moves."""
    given = [name for name in VELOCITY if name in feature.values]
    if len(given) == 1:
        yield feature.fault("velocity", f"{' and '.join(VELOCITY)} belong together", given[0])


def _parts(feature: Feature) -> Iterator[dict[str, Any]]:
    """Yield the raw parts of a scenario that one feature makes: zones of several polygons make several."""
    values, shape = dict(feature.values), feature.geometry
    if feature.kind == "user":
        velocity = [values.pop(name) for name in VELOCITY if name in values]
        moving = {"velocity_mps": [*map(float, velocity)]} if velocity else {}
        yield {**values, **moving, **places_of(shape)}
    elif feature.kind == "uav":
        end = values.pop("end_lat_deg", None), values.pop("end_lon_deg", None)
        ends = {} if end == (None, None) else {"end_deg": {"lat": end[0], "lon": end[1]}}
        yield {**_nested(values), "start_deg": place_of(shape), **ends}
    elif feature.kind == "rally_point":
        yield {"position_deg": place_of(shape)}
    elif isinstance(shape, Point):
        yield {"kind": "disc", "center_deg": place_of(shape), "radius_m": values["radius_m"]}
    else:
        for polygon in polygons_of(shape):
            yield {"kind": "polygon", "vertices_deg": outline_of(polygon)}


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a UAV, those of its battery and its rotors as parts."""
    made: dict[str, Any] = {name: value for name, value in values.items() if name not in NESTED}
    for column, (part, name) in NESTED.items():
        if column in values:
            made.setdefault(part, {})[name] = values[column]
    return made
