"""The plan's time grid: when slots begin, and how far each vehicle is from its planned point then."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pymap3d

GeoPoint = tuple[float, float]
"""Latitude, longitude in degrees."""


@dataclass(frozen=True)
class SlotGrid:
    """Slots of `duration_s` fleet seconds; slot 0 begins at `start_s`, slot n at start_s + n duration_s.

    `points` gives for a system id its planned points when slot 0, 1, ... begins; vehicles without points are not
    compared. ValueError for a duration that is not above 0.
    """

    duration_s: float
    start_s: float
    points: Mapping[int, Sequence[GeoPoint]]

    def __post_init__(self) -> None:
        if not 0.0 < self.duration_s < math.inf:
            raise ValueError(f"slot duration_s must be a finite number above 0, got {self.duration_s}")

    def begins_s(self, slot: int) -> float:
        """Return the fleet time at which a slot begins."""
        return self.start_s + slot * self.duration_s

    def slot_at(self, t_s: float) -> int:
        """Return the slot a moment lies in; negative before slot 0."""
        return math.floor((t_s - self.start_s) / self.duration_s + 1e-9)

    def error_m(self, system_id: int, slot: int, lat_deg: float, lon_deg: float) -> float | None:
        """Return how far (m, horizontally) a vehicle is from its point at the beginning of a slot, None without one."""
        points = self.points.get(system_id, ())
        if not 0 <= slot < len(points):
            return None
        east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *points[slot], 0.0)
        return math.hypot(float(east), float(north))
