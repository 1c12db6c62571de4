"""The ground as a grid of heights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from skyfolio.planner.arrays import Array
from skyfolio.planner.terrain import MAX_HEIGHTS, Terrain


def rough(seed: int, rows: int = 7, columns: int = 9) -> Terrain:
    heights = np.random.default_rng(seed).uniform(100.0, 300.0, size=(rows, columns))
    return Terrain(south_west_m=(-40.0, -20.0), spacing_m=30.0, heights_m=tuple(map(tuple, heights.tolist())))


def test_a_height_is_that_of_the_grid_at_its_places_and_a_mean_between_them() -> None:
    ridge = Terrain(south_west_m=(0.0, 0.0), spacing_m=10.0, heights_m=((0.0, 10.0, 0.0), (0.0, 30.0, 0.0)))
    assert ridge.height_m(np.array([[10.0, 0.0], [10.0, 10.0], [10.0, 5.0], [5.0, 5.0]])).tolist() == [10, 30, 20, 10]


def test_beyond_its_edge_the_ground_goes_on_as_it_is_there() -> None:
    ridge = Terrain(south_west_m=(0.0, 0.0), spacing_m=10.0, heights_m=((5.0, 10.0), (7.0, 30.0)))
    assert ridge.height_m(np.array([[-50.0, 0.0], [500.0, 10.0], [20.0, -9.0]])).tolist() == [5.0, 30.0, 10.0]


def test_the_top_of_a_saddle_between_two_places_is_found() -> None:
    saddle = Terrain(south_west_m=(0.0, 0.0), spacing_m=1.0, heights_m=((0.0, 100.0), (100.0, 0.0)))
    across = saddle.highest_on_segments(np.array([[0.0, 0.0]]), np.array([[1.0, 1.0]]))
    assert across == pytest.approx([50.0])  # both ends are at 0


def test_grounds_are_the_same_by_their_heights_whatever_was_asked_of_them_before() -> None:
    one, same, other = rough(1), rough(1), rough(2)
    for ground in (one, same, other):
        corners = np.array([[[0.0, 0.0]], [[90.0, 0.0]], [[0.0, 90.0]]])
        ground.highest_in_triangles(*corners)
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert one != "ground"


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000))
def test_no_sample_of_a_line_or_a_triangle_is_higher_than_the_highest_and_some_come_near(seed: int) -> None:
    terrain, rng = rough(seed), np.random.default_rng(seed)
    a, b, c = rng.uniform(-100.0, 300.0, size=(3, 1, 2))
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    top, sampled = terrain.highest_on_segments(a, b)[0], terrain.height_m(a + along * (b - a))
    assert sampled.max() <= top + 1e-9
    assert sampled.max() >= top - 1.5
    first, second = rng.uniform(size=(2, 20_000, 1))
    inside = np.where(first + second > 1.0, 1.0 - first, first), np.where(first + second > 1.0, 1.0 - second, second)
    heights = terrain.height_m(a + inside[0] * (b - a) + inside[1] * (c - a))
    assert heights.max() <= terrain.highest_in_triangles(a, b, c)[0] + 1e-9


def test_a_peak_amid_a_triangle_counts_though_no_edge_meets_it() -> None:
    heights = np.zeros((5, 5))
    heights[2, 2] = 80.0
    peak = Terrain(south_west_m=(0.0, 0.0), spacing_m=10.0, heights_m=tuple(map(tuple, heights.tolist())))
    corners: tuple[Array, Array, Array] = (np.array([[0.0, 0.0]]), np.array([[40.0, 0.0]]), np.array([[20.0, 40.0]]))
    assert peak.highest_in_triangles(*corners) == pytest.approx([80.0])
    edges = [peak.highest_on_segments(corners[i], corners[(i + 1) % 3])[0] for i in range(3)]
    assert max(edges) < 80.0


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000))
def test_of_many_triangles_each_has_the_places_that_are_inside_of_it_and_no_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = int(rng.integers(2, 12)), int(rng.integers(2, 12))
    terrain = Terrain(
        south_west_m=(-20.0, 30.0),
        spacing_m=10.0,
        heights_m=tuple(map(tuple, rng.uniform(0.0, 100.0, size=(rows, columns)).tolist())),
    )
    a, b, c = rng.uniform(-80.0, 180.0, size=(3, 50, 2))
    a[:20], b[:10] = np.round(a[:20], -1), np.round(b[:10], -1)  # corners that are places, and level edges
    c[::7] = b[::7]
    highest = terrain.highest_in_triangles(a, b, c)
    edges = [terrain.highest_on_segments(one, other) for one, other in ((a, b), (b, c), (c, a))]
    corners: NDArray[np.float64] = np.stack([a, b, c], axis=1)
    places = [(-20.0 + 10.0 * i, 30.0 + 10.0 * j, terrain.heights_m[j][i]) for j in range(rows) for i in range(columns)]
    inside = [
        max((up for *at, up in places if is_inside(triangle, at)), default=-np.inf) for triangle in corners.tolist()
    ]
    assert highest == pytest.approx(np.maximum(np.max(edges, axis=0), inside), abs=1e-6)


def is_inside(triangle: list[list[float]], at: list[float]) -> bool:
    sides = [
        (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0])
        for a, b in zip(triangle, [*triangle[1:], triangle[0]], strict=True)
    ]
    return all(side > 0.0 for side in sides) or all(side < 0.0 for side in sides)


@pytest.mark.parametrize(
    ("heights", "why"),
    [
        (((1.0, 2.0), (3.0,)), "at least 2"),
        (((1.0, 2.0), (3.0, 4.0, 5.0)), "heights_m.1: it has 3 heights, but every row must have as many as the first"),
        (((1.0, 2.0),), "at least 2"),
        (((1.0, float("nan")), (1.0, 1.0)), "finite"),
        (((1.0, 9_999.0), (1.0, 1.0)), "less than or equal to 9000"),
        (((1.0,) * 300,) * 300, f"300 x 300 heights are more than {MAX_HEIGHTS}; use a smaller area"),
    ],
)
def test_a_grid_that_is_none_is_refused(heights: tuple[tuple[float, ...], ...], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        Terrain(south_west_m=(0.0, 0.0), spacing_m=10.0, heights_m=heights)
