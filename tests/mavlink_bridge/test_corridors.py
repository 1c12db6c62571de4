"""What is kept apart where clocks have nothing in common."""

from typing import Any

import pytest

from skyfolio.mavlink_bridge.corridors import Corridor, meetings


def corridor(name: str, *level_m: tuple[float, float], required_m: float = 5.0, **options: Any) -> Corridor:
    return Corridor(uav_id=name, owner="somebody", required_m=required_m, level_m=level_m, **options)


EAST = corridor("a", (0.0, 0.0), (100.0, 0.0), height_m=430.0)


def test_lines_that_cross_meet_whenever_they_are_flown() -> None:
    (found,) = meetings([EAST], [corridor("b", (50.0, -50.0), (50.0, 50.0), height_m=430.0)])
    assert found.apart_m == 0.0
    assert str(found) == "'a' could come within 0.0 m of 'b' of somebody; 5 m are asked for"


@pytest.mark.parametrize(("height_m", "meet"), [(434.0, True), (435.0, False), (425.0, False), (None, True)])
def test_lines_that_cross_far_enough_above_each_other_do_not_meet(height_m: float | None, meet: bool) -> None:
    other = corridor("b", (50.0, -50.0), (50.0, 50.0), height_m=height_m)
    assert bool(meetings([EAST], [other])) is meet


def test_who_climbs_or_lands_beneath_a_line_meets_it_at_any_height() -> None:
    below = corridor("b", (50.0, 30.0), (50.0, 60.0), height_m=400.0, upright_m=(((50.0, 60.0),), ((50.0, 3.0),)))
    (found,) = meetings([EAST], [below])
    assert found.apart_m == 3.0
    assert len(meetings([below], [EAST])) == 1


def test_the_larger_distance_of_both_is_kept() -> None:
    beside = corridor("b", (0.0, 8.0), (100.0, 8.0), required_m=20.0, height_m=430.0)
    (found,) = meetings([EAST], [beside])
    assert (found.apart_m, found.required_m) == (8.0, 20.0)
    assert not meetings([EAST], [corridor("b", (0.0, 8.0), (100.0, 8.0), height_m=430.0)])


def test_one_that_stays_where_it_is_has_air_too_and_rounding_is_let_pass() -> None:
    here = corridor("b", (50.0, 4.995), (50.0, 4.995), height_m=430.0)
    assert meetings([EAST], [here])
    assert not meetings([EAST], [here], slack_m=0.01)


def test_air_is_seen_from_another_origin() -> None:
    moved = EAST.mapped(lambda point: (point[0] + 10.0, point[1] - 1.0))
    assert list(moved.level_m) == [(10.0, -1.0), (110.0, -1.0)]
