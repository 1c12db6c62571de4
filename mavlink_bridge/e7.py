"""Degrees as MAVLink sends them: integers of 1e-7 degrees, about 1.1 cm."""

from __future__ import annotations

from math import isfinite
from typing import TypeAlias

Place: TypeAlias = tuple[float, float]
"""Latitude and longitude, WGS-84 degrees."""


def to_e7(degrees: float) -> int:
    """Return degrees as MAVLink sends them: integer 1e-7 degrees (1.1 cm), rounded to nearest."""
    return round(degrees * 1e7)


def from_e7(e7: int) -> float:
    """Return integer 1e-7 degrees as degrees."""
    return e7 / 1e7


def place_of(lat_e7: float | None, lon_e7: float | None) -> Place | None:
    """Return latitude and longitude in degrees, or None for what autopilots send while they know no place.

    That is 0/0 (PX4 and ArduPilot before their first position), NaN (None in JSON), and numbers that are on no globe
    (INT32_MAX, which the MAVLink definitions use for "unknown").
    """
    if lat_e7 is None or lon_e7 is None or not (isfinite(lat_e7) and isfinite(lon_e7)):
        return None
    lat_deg, lon_deg = from_e7(int(lat_e7)), from_e7(int(lon_e7))
    nowhere = lat_deg == 0.0 and lon_deg == 0.0
    return None if nowhere or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0 else (lat_deg, lon_deg)
