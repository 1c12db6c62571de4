"""Plane geometry: points on paths, and distances to segments against shapely."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import LineString
from shapely import Point as GeoPoint

from skyfolio.planner.geometry import distance_to_segment_m, nearest_to_origin, point_at

PATH = [(0.0, 0.0), (10.0, 0.0), (10.0, 20.0)]
METRES = st.integers(-1_000_000, 1_000_000).map(lambda millimetres: millimetres / 1e3)
POINTS = st.tuples(METRES, METRES)


@pytest.mark.parametrize(
    ("slots", "point"),
    [
        (-1.0, (0.0, 0.0)),
        (0.0, (0.0, 0.0)),
        (0.5, (5.0, 0.0)),
        (1.25, (10.0, 5.0)),
        (2.0, (10.0, 20.0)),
        (9.0, PATH[2]),
    ],
)
def test_a_point_lies_between_those_of_the_slots_and_at_the_ends_beyond_them(
    slots: float, point: tuple[float, float]
) -> None:
    assert point_at(PATH, slots) == pytest.approx(point)


def test_a_path_of_one_slot_is_its_only_point() -> None:
    assert point_at([(3.0, 4.0)], 2.5) == (3.0, 4.0)


@given(point=POINTS, start=POINTS, end=POINTS)
def test_distances_to_a_segment_are_those_of_shapely(
    point: tuple[float, float], start: tuple[float, float], end: tuple[float, float]
) -> None:
    expected = GeoPoint(start).distance(GeoPoint(point))
    if start != end:  # shapely knows no segment of length 0
        expected = LineString([start, end]).distance(GeoPoint(point))
    assert distance_to_segment_m(point, start, end) == pytest.approx(expected, abs=1e-6)
    way = np.subtract(end, start)
    nearest = nearest_to_origin(np.subtract(start, point)[None], way[None])[0]
    assert np.hypot(*nearest) == pytest.approx(expected, abs=1e-6)
