"""Local metres of a vehicle, and where they are on the globe.

Only east and north are converted (pymap3d, WGS 84). A tangent plane leaves the ellipsoid with distance, so altitude
never goes through it: it is carried beside, in metres above the vehicle's home.
"""

import math

import pymap3d

Place = tuple[float, float]
"""Metres east and north of the spawn point."""


class LocalFrame:
    """East/north metres around one point on the globe. The last place is remembered: truth and streams use it again."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self._last: tuple[Place, Place] = ((math.nan, math.nan), (math.nan, math.nan))

    def to_local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return (east_m, north_m) of a point given in degrees."""
        east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, self.lat_deg, self.lon_deg, 0.0)
        return float(east), float(north)

    def to_geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (lat_deg, lon_deg) of a point given in metres east and north."""
        if self._last[0] != (east_m, north_m):
            lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0.0, self.lat_deg, self.lon_deg, 0.0)
            self._last = ((east_m, north_m), (float(lat), float(lon)))
        return self._last[1]


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
