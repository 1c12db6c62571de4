"""No-fly zones as half-planes: the last iterate lies in them, and nothing in them enters a zone."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from skyfolio.planner.arrays import Array
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of
from skyfolio.planner.reference.zones import half_planes
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon

ARROW = ((100.0, 100.0), (150.0, 150.0), (200.0, 100.0), (150.0, 220.0))
SCENARIO = scattered(1, 1, 2, seed=0).with_changes(
    no_fly=(NoFlyDisc(center_m=(60.0, 60.0), radius_m=25.0), NoFlyPolygon(vertices_m=ARROW))
)


@given(st.integers(0, 2**32 - 1))
def test_a_half_plane_holds_the_last_leg_and_none_of_the_zone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    here: Array = rng.uniform(30, 220, (2, 2))
    leg = LineString(here)
    zones = [Point(60.0, 60.0).buffer(25.0 - 1e-6, quad_segs=64), Polygon(ARROW)]
    assume(not leg.intersects(Point(60.0, 60.0).buffer(25.01)) and not leg.intersects(zones[1]))
    planes = list(half_planes(problem_of(SCENARIO), here))
    assert len(planes) == 3, "a disc, and the arrow as two triangles"
    for normal, offset in planes:
        assert (here @ normal[0] >= offset[0] - 1e-9).all()
    there = here + rng.normal(size=(2, 2)) * 10 ** rng.uniform(-1, 2)
    if all((there @ normal[0] >= offset[0]).all() for normal, offset in planes):
        assert not any(LineString(there).intersection(zone).length > 1e-6 for zone in zones)
