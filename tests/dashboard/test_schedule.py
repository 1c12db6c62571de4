"""Where a UAV should be, and how late it is."""

from math import hypot

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.api.dashboard.schedule import late_s as seconds_late
from skyfolio.api.dashboard.schedule import slip
from skyfolio.planner.geometry import point_at

EAST = [(25.0 * n, 0.0) for n in range(11)]
coordinates = st.floats(-500, 500)
paths = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=12)


@pytest.mark.parametrize(("late_s", "now_s"), [(0.0, 20.0), (2.0, 20.0), (-3.0, 20.0), (4.0, 33.0)])
def test_a_uav_on_its_track_is_as_late_as_the_track_says(late_s: float, now_s: float) -> None:
    here = point_at(EAST, (now_s - late_s) / 5.0)
    assert slip(EAST, 5.0, now_s, here).late_s == pytest.approx(late_s, abs=0.45)  # a metre at 5 m/s, and the step


def test_a_uav_that_hovers_where_it_should_is_not_late() -> None:
    assert slip([(5.0, 5.0)] * 10, 5.0, 30.0, (5.0, 5.0)) == (0.0, None)


def test_one_that_creeps_is_metres_off_and_never_seconds() -> None:
    creeping = [(0.4 * n, 0.0) for n in range(20)]  # 0.08 m/s: two metres are 25 s
    off_m, late_s = slip(creeping, 5.0, 50.0, (2.0, 0.0))
    assert off_m == pytest.approx(2.0)
    assert late_s is None


def test_a_uav_beside_its_track_is_judged_by_the_nearest_point() -> None:
    off_m, late_s = slip(EAST, 5.0, 20.0, (100.0, 30.0))
    assert off_m == pytest.approx(30.0)
    assert late_s == pytest.approx(0.0, abs=0.45)


@given(paths, st.floats(-3, 20))
def test_points_between_slots_lie_on_the_path(path: list[tuple[float, float]], slots: float) -> None:
    e, n = point_at(path, slots)
    at = min(max(slots, 0.0), len(path) - 1.0)
    low = min(int(at), max(len(path) - 2, 0))
    a, b = path[low], path[min(low + 1, len(path) - 1)]
    assert hypot(e - a[0], n - a[1]) + hypot(e - b[0], n - b[1]) == pytest.approx(
        hypot(a[0] - b[0], a[1] - b[1]), abs=1e-6
    )


@given(paths, st.floats(0, 60), coordinates, coordinates)
def test_slip_is_bounded_by_how_far_it_looks(path: list[tuple[float, float]], now_s: float, e: float, n: float) -> None:
    assert -10.0 - 1e-9 <= seconds_late(path, 5.0, now_s, (e, n)) <= 20.0 + 1e-9
