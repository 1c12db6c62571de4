"""East/north metres to WGS-84 degrees and back, by pymap3d.

Only the horizontal part is converted. A constant ENU "up" is a tangent plane and rises above the ellipsoid (3.9 m at
5 km), so points are kept on the ellipsoid here and altitude travels separately, above each vehicle's own home.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pymap3d import enu2geodetic, geodetic2enu

from skyfolio.planner.parts import Origin

_PASSES = 6
"""Each pass shrinks the height error by about (distance / Earth radius)^2; six reach nanometres at 100 km."""


def east_north_to_geodetic(origin: Origin, east_m: float, north_m: float) -> tuple[float, float]:
    """Return (latitude, longitude) in degrees of the ellipsoid's point (east, north) metres from `origin`."""
    return points_to_geodetic(origin, [(east_m, north_m)])[0]


def points_to_geodetic(origin: Origin, points_m: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return (latitude, longitude) in degrees of many points, in about the time of one."""
    east_m, north_m = np.array(points_m, dtype=float).reshape(-1, 2).T
    up_m = np.zeros(len(points_m))
    lat_deg = lon_deg = up_m
    for _ in range(_PASSES):
        lat_deg, lon_deg, height_m = enu2geodetic(east_m, north_m, up_m, origin.lat_deg, origin.lon_deg, 0.0)
        up_m = up_m - height_m
    return list(zip(lat_deg.tolist(), lon_deg.tolist(), strict=True))


def geodetic_to_east_north(origin: Origin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Return (east, north) metres from `origin` of a point on the ellipsoid, given in degrees."""
    east_m, north_m, _ = geodetic2enu(lat_deg, lon_deg, 0.0, origin.lat_deg, origin.lon_deg, 0.0)
    return float(east_m), float(north_m)
