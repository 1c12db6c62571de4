from __future__ import annotations

from collections.abc import Callable
from math import hypot

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import ReturnPathsTooClose, check_return_paths
from skyfolio.mavlink_bridge.plane import segment_distances_m
from skyfolio.mavlink_bridge.returns import return_point_m
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import RallyPoint
from tests.planner.hills import hill

PlanOf = Callable[..., Plan]
points = st.tuples(st.floats(-50, 50), st.floats(-50, 50))


def test_crossing_ways_home_name_both_uavs(plan_of: PlanOf) -> None:
    plan = plan_of({"uav-1": [(0, 0), (0, 10)], "uav-2": [(30, 0), (30, 10)]})
    with pytest.raises(ReturnPathsTooClose, match=r"'uav-1' and 'uav-2' come within 0.00 m"):
        check_return_paths(plan, {"uav-1": (30.0, -20.0), "uav-2": (0.0, -20.0)})


def test_a_return_ends_at_home_or_at_a_rally_point_that_is_nearer() -> None:
    home, rally = (0.0, 0.0), [(100.0, 0.0), (0.0, 90.0)]
    assert return_point_m((40.0, 0.0), home, rally) == home
    assert return_point_m((60.0, 0.0), home, rally) == (100.0, 0.0)
    assert return_point_m((500.0, 0.0), home, []) == home


def test_ways_to_rally_points_count_in_place_of_those_home_but_not_over_terrain(plan_of: PlanOf) -> None:
    plan = plan_of({"uav-1": [(0, 0), (0, 10)], "uav-2": [(30, 0), (30, 10)]})
    homes = {"uav-1": (0.0, -20.0), "uav-2": (30.0, -20.0)}
    between_them = (RallyPoint(position_m=(15.0, 10.0)),)
    shared = plan.model_copy(update={"scenario": plan.scenario.with_changes(rally_points=between_them)})
    with pytest.raises(ReturnPathsTooClose, match=r"'uav-1' and 'uav-2' come within 0.00 m"):
        check_return_paths(shared, homes)
    own = (RallyPoint(position_m=(-15.0, 10.0)), RallyPoint(position_m=(45.0, 10.0)))
    apart = plan.model_copy(update={"scenario": plan.scenario.with_changes(rally_points=own)})
    check_return_paths(apart, {"uav-1": (30.0, -40.0), "uav-2": (0.0, -40.0)})  # the ways home would cross
    over = shared.scenario.with_changes(area_m=((-40.0, -40.0), (100.0, 100.0)), terrain=hill())
    check_return_paths(shared.model_copy(update={"scenario": over}), homes)


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
