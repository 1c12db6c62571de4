"""Where a vehicle's local metres are on the globe.

Only east and north are converted (pymap3d, WGS 84). A tangent plane leaves the ellipsoid with distance, so altitude
never goes through it: it is carried beside, in metres above the vehicle's home.
"""

import pymap3d


class LocalFrame:
    """East/north metres around one point on the globe."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg

    def to_local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return (east_m, north_m) of a point given in degrees."""
        east, north, _ = pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, self.lat_deg, self.lon_deg, 0.0)
        return float(east), float(north)

    def to_geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return (lat_deg, lon_deg) of a point given in metres east and north."""
        lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0.0, self.lat_deg, self.lon_deg, 0.0)
        return float(lat), float(lon)
