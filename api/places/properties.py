"""What the properties of a feature say: its kind, its id, and the numbers of the scenario's fields."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import PurePath
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError
from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.faults import Fault
from skyfolio.api.places.files import MAX_FEATURES, Feature, Holding, Kind, SourceFile
from skyfolio.planner.scenario import Battery, Identifier, NoFlyDisc, Rotors, Uav, User

KINDS: Mapping[str, Kind] = {
    "user": "user",
    "users": "user",
    "uav": "uav",
    "uavs": "uav",
    "no_fly": "no_fly",
    "no_fly_zones": "no_fly",
    "zone": "no_fly",
    "zones": "no_fly",
    "area": "area",
    "rally_point": "rally_point",
    "rally_points": "rally_point",
    "rally": "rally_point",
}
DERIVED = frozenset({"path", "position"})
"""Kinds that an export of a plan has beside its scenario; they are not read."""
UNKNOWN_KIND = (
    "it must say what it is: give it a property or column `kind` (user, uav, no_fly, area or rally_point), or name "
    "the file for what is in it (users.csv, uavs.kml, no_fly.geojson, area.geojson, rally_points.csv)"
)
ALIASES: Mapping[str, tuple[str, ...]] = {
    "lat_deg": ("lat_deg", "lat", "latitude", "y"),
    "lon_deg": ("lon_deg", "lon", "lng", "long", "longitude", "x"),
}
VELOCITY = ("velocity_east_mps", "velocity_north_mps")
"""Columns of a user's `velocity_mps`."""
NESTED: Mapping[str, tuple[str, str]] = {
    f"{part}_{name}": (part, name)
    for part, model in (("battery", Battery), ("rotors", Rotors))
    for name in model.model_fields
}
"""Columns of what a UAV has, as `battery_usable_wh`: the part and the field of it."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_IDENTIFIER = TypeAdapter(Identifier)
_PARTS: Mapping[Kind, type[BaseModel]] = {"user": User, "uav": Uav, "no_fly": NoFlyDisc}


class WrongValueError(ValueError):
    """A value that cannot be read; `rule` names what it breaks."""

    def __init__(self, rule: str, message: str) -> None:
        super().__init__(message)
        self.rule = rule


def number(value: Any) -> float | None:
    """Return the number that a cell or property holds, None if it is empty. Raises WrongValueError."""
    if value is None or (isinstance(value, float) and value != value):  # how tables write that there is none
        return None
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    text = str(value).strip()
    if not text:
        return None
    if _DECIMAL_COMMA.fullmatch(text):
        raise WrongValueError("decimal_comma", f"{text!r} has a decimal comma; write {text.replace(',', '.')}")
    if not _NUMBER.fullmatch(text) or not isfinite(float(text)):
        raise WrongValueError("number", f"{text[:60]!r} is not a number")
    return float(text)


def named_like(columns: Iterable[str], name: str) -> str | None:
    """Return the column that holds this coordinate under one of its usual names, or None."""
    by_lower = {column.strip().lower(): column for column in columns}
    return next((by_lower[alias] for alias in ALIASES[name] if alias in by_lower), None)


@dataclass
class Reading:
    """Reads the features of one file, one after the other, and collects what is wrong."""

    file: SourceFile
    features: list[Feature] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    _used: set[str] = field(default_factory=set)
    _unused: set[str] = field(default_factory=set)

    def take(
        self,
        row: str,
        geometry: BaseGeometry | None,
        given: Mapping[str, Any],
        *,
        folders: Iterable[str] = (),
        columns: Mapping[str, str] | None = None,
        used: frozenset[str] = frozenset(),
    ) -> None:
        """Take one feature. given: its properties; folders: what it is in, innermost first; used: already read."""
        if len(self.features) >= MAX_FEATURES:
            if len(self.features) == MAX_FEATURES and not any(one.rule == "count" for one in self.faults):
                self.faults.append(self.file.fault("count", f"it holds more than {MAX_FEATURES} features"))
            return
        said = str(given.get("kind") or "").strip().lower().replace("-", "_")
        if said in DERIVED:
            return
        kind = self._kind(said, folders)
        if kind is None:
            self.faults.append(self.file.fault("kind", UNKNOWN_KIND, row, "kind"))
        elif geometry is None or geometry.is_empty:
            self.faults.append(self.file.fault("geometry", "it has no place", row, "geometry"))
        else:
            values = self._values(row, kind, given, used)
            made = Feature(file=self.file, row=row, kind=kind, geometry=geometry, values=values, columns=columns or {})
            self.features.append(made)

    def refuse(self, rule: str, message: str, row: str = "", column: str = "") -> None:
        """Note a fault of the file."""
        self.faults.append(self.file.fault(rule, message, row, column))

    def number(self, row: str, column: str, value: Any) -> float | None:
        """Return the number in a cell; None if it is empty, or wrong, which is noted."""
        try:
            return number(value)
        except WrongValueError as error:
            self.refuse(error.rule, str(error), row, column)
            return None

    def holding(self, settings: Mapping[str, Any] | None = None) -> Holding:
        """Return what was read."""
        ignored = frozenset(self._unused - self._used)
        return Holding(features=self.features, faults=self.faults, settings=settings or {}, ignored=ignored)

    def _kind(self, said: str, folders: Iterable[str]) -> Kind | None:
        if said:
            return KINDS.get(said)
        if self.file.kind is not None:
            return self.file.kind
        names = [*folders, PurePath(self.file.name).stem]
        return next((kind for name in names if (kind := _kind_in(name)) is not None), None)

    def _values(self, row: str, kind: Kind, given: Mapping[str, Any], used: frozenset[str]) -> dict[str, Any]:
        numbers = number_fields(kind)
        values: dict[str, Any] = {}
        for name, raw in given.items():
            if name in used or name in {"kind", "id", "name"}:
                continue
            if name not in numbers:
                self._unused.update({name} if raw is not None and raw != "" else ())
                continue
            self._used.add(name)
            value = self.number(row, name, raw)
            if value is not None:
                values[name] = int(value) if numbers[name] is int and value.is_integer() else value
        return {**values, **_identity(given)}


def number_fields(kind: Kind) -> dict[str, type]:
    """Return the number fields of this kind's part of a scenario, and whether each is an `int` or a `float`."""
    part = _PARTS.get(kind)
    if part is None:
        return {}
    places = {name.removesuffix("_deg") for name in part.model_fields if name.endswith("_deg")}
    ends = {"end_lat_deg": float, "end_lon_deg": float} if "end" in places else {}
    moving = dict.fromkeys(VELOCITY, float) if "velocity_mps" in part.model_fields else {}
    owned = {name: float for name, (whose, _) in NESTED.items() if whose in part.model_fields}
    return (
        ends
        | moving
        | owned
        | {
            name: float if "float" in str(info.annotation) or "float" in str(info.metadata) else int
            for name, info in part.model_fields.items()
            if name not in {"id", "kind", "velocity_mps", "battery", "rotors"}
            and name.removesuffix("_deg").removesuffix("_m") not in places
        }
    )


def _identity(given: Mapping[str, Any]) -> dict[str, str]:
    """Return the id that is given, or a name that can be one; free text is no id, so that one will be made."""
    said = str(given["id"]).strip() if given.get("id") is not None else ""
    if said:
        return {"id": said}
    name = str(given.get("name") or "").strip()
    try:
        return {"id": _IDENTIFIER.validate_python(name)}
    except ValidationError:
        return {}  # a name such as "Town hall": the feature gets a number


def _kind_in(name: str) -> Kind | None:
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    return next((kind for word, kind in sorted(KINDS.items(), reverse=True) if plain.startswith(word)), None)
