"""Local metres of a vehicle, and where they are on the globe.

Only east and north are converted (WGS 84; as pymap3d does it, and much faster for one point). A tangent plane leaves
the ellipsoid with distance, so altitude never goes through it: it is carried beside, in metres above home.
"""

import math

EQUATOR_M, POLE_M = 6_378_137.0, 6_356_752.314245179
"""Semi-axes of the WGS-84 ellipsoid."""
_E2 = 1.0 - (POLE_M / EQUATOR_M) ** 2
Place = tuple[float, float]
"""Metres east and north of the spawn point."""


class LocalFrame:
    """East/north metres around one point on the globe. The last place is remembered: truth and streams use it again."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self._origin = _ecef_of(lat_deg, lon_deg)
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        self._sin_lat, self._cos_lat, self._sin_lon, self._cos_lon = (
            *(math.sin(lat), math.cos(lat)),
            *(math.sin(lon), math.cos(lon)),
        )
        self._last: tuple[Place, Place] = ((math.nan, math.nan), (math.nan, math.nan))

    def to_local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return (east_m, north_m) of a point given in degrees."""
        here = _ecef_of(lat_deg, lon_deg)
        u, v, w = here[0] - self._origin[0], here[1] - self._origin[1], here[2] - self._origin[2]
        out = self._cos_lon * u + self._sin_lon * v
        return self._cos_lon * v - self._sin_lon * u, self._cos_lat * w - self._sin_lat * out

    def to_geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (lat_deg, lon_deg) of a point given in metres east and north."""
        if self._last[0] != (east_m, north_m):
            out = -self._sin_lat * north_m
            x = self._origin[0] + self._cos_lon * out - self._sin_lon * east_m
            y = self._origin[1] + self._sin_lon * out + self._cos_lon * east_m
            z = self._origin[2] + self._cos_lat * north_m
            self._last = ((east_m, north_m), _geodetic_of(x, y, z))
        return self._last[1]


def _ecef_of(lat_deg: float, lon_deg: float) -> tuple[float, float, float]:
    """Return earth-centred metres of a point on the ellipsoid."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    normal_m = EQUATOR_M / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    out_m = normal_m * math.cos(lat)
    return out_m * math.cos(lon), out_m * math.sin(lon), normal_m * (1.0 - _E2) * math.sin(lat)


def _geodetic_of(x: float, y: float, z: float) -> tuple[float, float]:
    """Return latitude and longitude, degrees, of earth-centred metres near the ellipsoid (Bowring 1976)."""
    out_m = math.hypot(x, y)
    reduced = math.atan2(z * EQUATOR_M, out_m * POLE_M)
    lat = math.atan2(
        z + (EQUATOR_M**2 - POLE_M**2) / POLE_M * math.sin(reduced) ** 3,
        out_m - _E2 * EQUATOR_M * math.cos(reduced) ** 3,
    )
    return math.degrees(lat), math.degrees(math.atan2(y, x))


def corner_speed(start: Place, corner: Place, goal: Place, acceleration: float, radius: float) -> float:
    """Return the speed, m/s, at which a turn fits in the acceptance radius: sqrt(a r tan(angle between the legs / 2)).

    Places are in metres, `acceleration` in m/s^2, `radius` in metres; infinite where there is no turn.
    """
    before, after = math.dist(start, corner), math.dist(corner, goal)
    if before < 0.1 or after < 0.1:
        return math.inf if before < 0.1 else 0.0
    back = (start[0] - corner[0]) * (goal[0] - corner[0]) + (start[1] - corner[1]) * (goal[1] - corner[1])
    angle = math.acos(max(-1.0, min(1.0, back / (before * after))))
    return math.sqrt(acceleration * radius * math.tan(angle / 2.0)) if angle < math.pi - 1e-6 else math.inf


def distance_from_segment(a: Place, b: Place, point: Place) -> float:
    """Return the distance in metres of `point` from the segment from a to b."""
    along = (b[0] - a[0], b[1] - a[1])
    length2 = along[0] ** 2 + along[1] ** 2
    share = 1.0
    if length2 > 0.0:
        share = max(0.0, min(1.0, ((point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1]) / length2))
    return math.hypot(a[0] + share * along[0] - point[0], a[1] + share * along[1] - point[1])
