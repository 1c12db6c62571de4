"""sim.specs and sim.geo"""

import math
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.specs import VehicleSpec, grid_of


@given(east=st.floats(-5000.0, 5000.0), north=st.floats(-5000.0, 5000.0), lat=st.floats(-70.0, 70.0))
def test_metres_survive_the_way_to_the_globe_and_back(east: float, north: float, lat: float) -> None:
    frame = LocalFrame(lat, 8.5)
    assert frame.to_local(*frame.to_geodetic(east, north)) == pytest.approx((east, north), abs=0.01)


def test_a_grid_has_ids_from_one_and_keeps_its_spacing() -> None:
    specs = grid_of(5, 47.4, 8.5, spacing_m=10.0)
    frame = LocalFrame(47.4, 8.5)
    places = [frame.to_local(spec.home_lat_deg, spec.home_lon_deg) for spec in specs]
    assert [spec.system_id for spec in specs] == [1, 2, 3, 4, 5]
    assert min(math.dist(a, b) for a, b in combinations(places, 2)) == pytest.approx(10.0, abs=0.001)
    assert max(math.hypot(*place) for place in places) < 15.0


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ((0, 47.0, 8.0), "system_id"),
        ((255, 47.0, 8.0), "system_id"),
        ((1, math.nan, 8.0), "home_lat_deg"),
        ((1, 47.0, 181.0), "home_lon_deg"),
        ((1, 47.0, 8.0, math.inf), "home_alt_m"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused_by_name(values: tuple[float, ...], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        VehicleSpec(*values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("count", "spacing", "name"), [(0, 10.0, "count"), (255, 10.0, "count"), (3, 0.0, "spacing_m")]
)
def test_a_grid_that_cannot_be_is_refused_by_name(count: int, spacing: float, name: str) -> None:
    with pytest.raises(ValueError, match=name):
        grid_of(count, 47.4, 8.5, spacing)
