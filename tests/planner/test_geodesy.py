from __future__ import annotations

from math import hypot

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymap3d import geodetic2enu
from pymap3d.vincenty import vdist

from skyfolio.mavlink_bridge.e7 import from_e7, to_e7
from skyfolio.planner.geodesy import (
    east_north_to_geodetic,
    geodetic_to_east_north,
    points_to_geodetic,
)
from skyfolio.planner.scenario import Origin

metres = st.floats(-100_000, 100_000)
near = st.floats(-5_000, 5_000)
origins = st.builds(Origin, lat_deg=st.floats(-80, 80), lon_deg=st.floats(-179, 179))


@given(origin=origins, east=metres, north=metres)
def test_east_north_survives_the_way_to_degrees_and_back(origin: Origin, east: float, north: float) -> None:
    lat, lon = east_north_to_geodetic(origin, east, north)
    back = geodetic_to_east_north(origin, lat, lon)
    assert hypot(back[0] - east, back[1] - north) < 1e-4


@given(origin=origins, east=near, north=near)
def test_rounding_to_1e7_degrees_moves_a_point_by_less_than_a_centimetre(
    origin: Origin, east: float, north: float
) -> None:
    lat, lon = east_north_to_geodetic(origin, east, north)
    back = geodetic_to_east_north(origin, from_e7(to_e7(lat)), from_e7(to_e7(lon)))
    assert hypot(back[0] - east, back[1] - north) < 0.01


@given(origin=origins, east=st.floats(10, 5_000), north=st.floats(10, 5_000))
def test_distance_from_the_origin_is_the_geodesic_of_vincenty(origin: Origin, east: float, north: float) -> None:
    lat, lon = east_north_to_geodetic(origin, east, north)
    distance, _ = vdist(origin.lat_deg, origin.lon_deg, lat, lon)
    assert float(distance) == pytest.approx(hypot(east, north), rel=1e-6)


@given(origin=origins, points=st.lists(st.tuples(metres, metres), max_size=5))
def test_many_points_are_where_each_is_alone(origin: Origin, points: list[tuple[float, float]]) -> None:
    together = points_to_geodetic(origin, points)
    for place, point in zip(together, points, strict=True):
        assert place == pytest.approx(east_north_to_geodetic(origin, *point), abs=1e-12)


def test_east_raises_longitude_and_north_raises_latitude() -> None:
    zurich = Origin(lat_deg=47.397742, lon_deg=8.545594)
    assert east_north_to_geodetic(zurich, 0, 0) == pytest.approx((47.397742, 8.545594), abs=1e-12)
    lat, lon = east_north_to_geodetic(zurich, 100, 0)
    assert lon > 8.5469
    assert lat == pytest.approx(47.397742, abs=1e-7)
    lat, lon = east_north_to_geodetic(zurich, 0, 100)
    assert lat > 47.3986
    assert lon == pytest.approx(8.545594, abs=1e-12)


@given(e7=st.integers(-1_800_000_000, 1_800_000_000))
def test_e7_integers_survive_degrees(e7: int) -> None:
    assert to_e7(from_e7(e7)) == e7


@given(origin=origins, lat_deg=st.floats(-85, 85), lon_deg=st.floats(-180, 180))
def test_metres_of_a_point_are_those_of_pymap3d(origin: Origin, lat_deg: float, lon_deg: float) -> None:
    east, north, _ = geodetic2enu(lat_deg, lon_deg, 0.0, origin.lat_deg, origin.lon_deg, 0.0)
    assert geodetic_to_east_north(origin, lat_deg, lon_deg) == pytest.approx((east, north), abs=1e-6)
