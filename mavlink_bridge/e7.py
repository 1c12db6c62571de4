"""Degrees as MAVLink sends them: integers of 1e-7 degrees, about 1.1 cm."""

from __future__ import annotations


def to_e7(degrees: float) -> int:
    """Return degrees as MAVLink sends them: integer 1e-7 degrees (1.1 cm), rounded to nearest."""
    return round(degrees * 1e7)


def from_e7(e7: int) -> float:
    """Return integer 1e-7 degrees as degrees."""
    return e7 / 1e7
