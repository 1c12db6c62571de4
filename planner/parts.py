"""What the parts of a scenario are made of: numbers, places in metres and in degrees, and the base of every part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100_000, le=100_000)]
Point = tuple[Coordinate, Coordinate]
"""East, north in metres from the origin; beyond 100 km a flat local frame is no longer honest."""

Identifier = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
BitsPerSecond = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e15)]

MAX_VERTICES = 200
"""Of the outline of one area or no-fly zone."""


class Frozen(BaseModel):
    """The base of all parts: immutable, keyword-only, and strict about unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PositionDeg(Frozen):
    """A place on the WGS-84 ellipsoid, degrees; a field in degrees has its unit in its name (`position_deg`)."""

    lat: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-90, le=90)]
    lon: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-180, le=180)]


def left_out(description: str) -> Any:
    """Return an optional field that is left out of what is written when it was not given."""
    return Field(default=None, exclude_if=lambda value: value is None, description=description)


def in_degrees(description: str) -> Any:
    """Return the field of a place in degrees. It is left out of what is written when it was not given."""
    return left_out(description)


def either(*ways: tuple[str, ...]) -> Any:
    """Return a change of a part's JSON schema: the fields of one of these ways are required, or of several."""
    optional = {field for way in ways for field in way}

    def change(schema: dict[str, Any]) -> None:
        schema["required"] = [field for field in schema["required"] if field not in optional]
        schema["anyOf"] = [{"required": list(way)} for way in ways]

    return change


class Placed(Frozen):
    """A part that has places, each in metres and perhaps in degrees too."""

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with some fields replaced; degrees of a place that is moved in metres are dropped."""
        return super().model_copy(update=without_stale_degrees(type(self), update or {}), deep=deep)


def without_stale_degrees(kind: type[BaseModel], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes of a part's fields, and no degrees for each place that is given in metres alone."""
    twins = {name: f"{name.removesuffix('_m')}_deg" for name in changes if name.endswith("_m")}
    stale = {twin: None for twin in twins.values() if twin in kind.model_fields and twin not in changes}
    return {**changes, **stale}


class Origin(Frozen):
    """Where (0, 0) of the local east/north frame lies on the WGS-84 ellipsoid, degrees."""

    lat_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-85, le=85)]
    lon_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-180, le=180)]
