"""Bounds of the values that a simulated fleet accepts: each refusal names the field, its value and the rule."""

import math
from typing import Any

LONGEST_S = 1_000_000.0
"""No duration and no moment of a simulated fleet lies beyond this (eleven days)."""
MOST_UPLOADS = 1000
LAST_SYSTEM_ID = 254


def check_number(name: str, value: Any, low: float, high: float) -> None:
    """Raise ValueError unless `value` is a finite number from `low` to `high`, both included."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} must be a number, got {value!r}")
    if not (low <= value <= high and math.isfinite(value)):
        raise ValueError(f"{name} must be between {low:.9g} and {high:.9g}, got {value!r}")


def check_whole(name: str, value: Any, low: int, high: int) -> None:
    """Raise ValueError unless `value` is a whole number from `low` to `high`, both included."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number between {low} and {high}, got {value!r}")


def check_vehicle(system_id: Any) -> None:
    """Raise ValueError unless `system_id` can be a vehicle's."""
    check_whole("system_id", system_id, 1, LAST_SYSTEM_ID)


def check_duration(name: str, value: Any) -> None:
    """Raise ValueError unless `value` is a number of seconds above 0 and at most LONGEST_S."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not 0.0 < value <= LONGEST_S:
        raise ValueError(f"{name} must be a number of seconds above 0 and at most {LONGEST_S:.9g}, got {value!r}")


def check_lasting(for_s: Any) -> None:
    """Raise ValueError unless `for_s` is None (for good) or a duration in seconds."""
    if for_s is not None:
        check_duration("for_s", for_s)
