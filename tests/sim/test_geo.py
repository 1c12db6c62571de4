import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.sim.geo import LocalFrame

metres = st.floats(-5_000, 5_000)
latitudes, longitudes = st.floats(-85, 85), st.floats(-179, 179)


@given(lat_deg=latitudes, lon_deg=longitudes, east_m=metres, north_m=metres)
def test_places_are_those_of_pymap3d_both_ways(lat_deg: float, lon_deg: float, east_m: float, north_m: float) -> None:
    frame = LocalFrame(lat_deg, lon_deg)
    lat, lon, _ = pymap3d.enu2geodetic(east_m, north_m, 0.0, lat_deg, lon_deg, 0.0)
    assert frame.to_geodetic(east_m, north_m) == pytest.approx((lat, lon), abs=1e-9)
    east, north, _ = pymap3d.geodetic2enu(lat, lon, 0.0, lat_deg, lon_deg, 0.0)
    assert frame.to_local(lat, lon) == pytest.approx((east, north), abs=1e-6)
