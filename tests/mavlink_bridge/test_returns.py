from __future__ import annotations

from collections.abc import Callable
from math import hypot

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import ReturnPathsTooClose, check_return_paths
from skyfolio.mavlink_bridge.plane import segment_distances_m
from skyfolio.planner.plans import Plan

PlanOf = Callable[..., Plan]
points = st.tuples(st.floats(-50, 50), st.floats(-50, 50))


def test_crossing_ways_home_name_both_uavs(plan_of: PlanOf) -> None:
    plan = plan_of({"uav-1": [(0, 0), (0, 10)], "uav-2": [(30, 0), (30, 10)]})
    with pytest.raises(ReturnPathsTooClose, match=r"'uav-1' and 'uav-2' come within 0.00 m"):
        check_return_paths(plan, {"uav-1": (30.0, -20.0), "uav-2": (0.0, -20.0)})


def test_parallel_ways_home_are_fine(plan_of: PlanOf) -> None:
    plan = plan_of({"uav-1": [(0, 0), (0, 10)], "uav-2": [(30, 0), (30, 10)]})
    check_return_paths(plan, {"uav-1": (0.0, -20.0), "uav-2": (30.0, -20.0)})


def test_a_segment_of_hardly_any_length_has_a_distance_all_the_same() -> None:
    (apart_m,) = segment_distances_m([((0.0, 0.0), (0.0, 0.0))], [((3.0, 4.0), (3.0, 4.0 + 1e-299))])
    assert apart_m == 5.0
    (apart_m,) = segment_distances_m([((0.0, 0.0), (0.0, 0.0))], [((0.0, 0.0), (0.0, 3.628e-299))])
    assert apart_m == 0.0


@given(a=points, b=points, c=points, d=points)
def test_segment_distance_is_the_least_over_finely_sampled_points(
    a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]
) -> None:
    def along(p: tuple[float, float], q: tuple[float, float], n: int = 60) -> list[tuple[float, float]]:
        return [(p[0] + (q[0] - p[0]) * i / n, p[1] + (q[1] - p[1]) * i / n) for i in range(n + 1)]

    sampled = min(hypot(p[0] - q[0], p[1] - q[1]) for p in along(a, b) for q in along(c, d))
    spacing = (hypot(b[0] - a[0], b[1] - a[1]) + hypot(d[0] - c[0], d[1] - c[1])) / 60
    (exact,) = segment_distances_m([(a, b)], [(c, d)])
    assert exact <= sampled + 1e-8
    assert sampled <= exact + spacing + 1e-8
