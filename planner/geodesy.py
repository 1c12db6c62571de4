"""East/north metres to WGS-84 degrees and back, by pymap3d, and for one point as exactly and a hundred times as fast.

Only the horizontal part is converted. A constant ENU "up" is a tangent plane and rises above the ellipsoid (3.9 m at
5 km), so points are kept on the ellipsoid here and altitude travels separately, above each vehicle's own home.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import atan2, cos, degrees, hypot, radians, sin, sqrt

import numpy as np
from pymap3d import enu2geodetic

from skyfolio.planner.parts import Origin

_PASSES = 6
"""Each pass shrinks the height error by about (distance / Earth radius)^2; six reach nanometres at 100 km."""

_EQUATOR_M, _E2 = 6_378_137.0, 0.006694379990141317
"""Semi-major axis and squared eccentricity of the WGS-84 ellipsoid."""


def east_north_to_geodetic(origin: Origin, east_m: float, north_m: float) -> tuple[float, float]:
    """Return (latitude, longitude) in degrees of the ellipsoid's point (east, north) metres from `origin`.

    The line through it along the origin's vertical meets the ellipsoid (1-e2)(x^2 + y^2) + z^2 = (1-e2) a^2 where a
    quadratic equation has its root nearer to the tangent plane.
    """
    at_x, at_y, at_z, sin_lat, cos_lat, sin_lon, cos_lon = _frame_of(origin.lat_deg, origin.lon_deg)
    x = at_x - sin_lon * east_m - sin_lat * cos_lon * north_m
    y = at_y + cos_lon * east_m - sin_lat * sin_lon * north_m
    z = at_z + cos_lat * north_m
    up_x, up_y = cos_lat * cos_lon, cos_lat * sin_lon
    square = (1.0 - _E2) * cos_lat**2 + sin_lat**2
    half = (1.0 - _E2) * (up_x * x + up_y * y) + sin_lat * z
    rest = (1.0 - _E2) * (x**2 + y**2 - _EQUATOR_M**2) + z**2
    up_m = -rest / (half + sqrt(half**2 - square * rest))
    x, y, z = x + up_x * up_m, y + up_y * up_m, z + sin_lat * up_m
    return degrees(atan2(z, (1.0 - _E2) * hypot(x, y))), degrees(atan2(y, x))


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
    x, y, z, sin_lat, cos_lat, sin_lon, cos_lon = _frame_of(origin.lat_deg, origin.lon_deg)
    here_x, here_y, here_z = _ecef_of(lat_deg, lon_deg)
    u, v, w = here_x - x, here_y - y, here_z - z
    return cos_lon * v - sin_lon * u, cos_lat * w - sin_lat * (cos_lon * u + sin_lon * v)


@lru_cache(64)
def _frame_of(lat_deg: float, lon_deg: float) -> tuple[float, ...]:
    """Return the earth-centred metres of an origin, and sine and cosine of its latitude and longitude."""
    lat, lon = radians(lat_deg), radians(lon_deg)
    return (*_ecef_of(lat_deg, lon_deg), sin(lat), cos(lat), sin(lon), cos(lon))


def _ecef_of(lat_deg: float, lon_deg: float) -> tuple[float, float, float]:
    """Return the earth-centred metres of a point on the ellipsoid."""
    lat, lon = radians(lat_deg), radians(lon_deg)
    normal_m = _EQUATOR_M / sqrt(1.0 - _E2 * sin(lat) ** 2)
    return normal_m * cos(lat) * cos(lon), normal_m * cos(lat) * sin(lon), normal_m * (1.0 - _E2) * sin(lat)
