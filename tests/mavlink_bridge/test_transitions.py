"""Separation while changing over: live positions, and the reserved air of UAVs we lost."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations, pairwise
from math import hypot
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge.errors import TransitionTooClose
from skyfolio.mavlink_bridge.ghosts import Airspace, Ghost, Way
from skyfolio.mavlink_bridge.route import Route
from skyfolio.mavlink_bridge.transitions import check_transition

HOW: Any = {"now_s": 2.0, "first_due_s": 5.0, "slot_s": 5.0, "required_m": 4.0}
Point = tuple[float, float]


def ghost(*, path: list[Point], last: Point = (500.0, 500.0), home: Point | None = None) -> Ghost:
    return Ghost(
        uav_id="uav-3",
        lost_at_s=0.0,
        last_seen_m=last,
        ways=(Way(route=Route(path, 5.0), began_s=0.0),),
        home_m=home,
        deadline_s=600.0,
    )


def test_two_that_swap_places_are_refused_with_distance_and_time() -> None:
    live = {"uav-1": (0.0, 0.0), "uav-2": (30.0, 1.0)}
    with pytest.raises(TransitionTooClose, match=r"'uav-1' and 'uav-2' would come within 1.00 m at 3.5 s"):
        check_transition(live, {"uav-1": [(30.0, 0.0)], "uav-2": [(0.0, 1.0)]}, **HOW)


def test_one_that_does_not_fly_the_new_plan_is_where_it_is() -> None:
    live = {"uav-1": (0.0, 0.0), "uav-2": (15.0, 0.0)}
    with pytest.raises(TransitionTooClose, match="uav-2"):
        check_transition(live, {"uav-1": [(30.0, 0.0)]}, **HOW)
    check_transition(live, {"uav-1": [(0.0, 30.0)]}, **HOW)


def test_live_positions_count_even_without_any_path() -> None:
    with pytest.raises(TransitionTooClose, match=r"within 3\.00 m"):
        check_transition({"uav-1": (0.0, 0.0), "uav-2": (3.0, 0.0)}, {}, **HOW)


def test_the_ways_to_rally_points_are_reserved_air_too_from_where_it_was_seen_and_from_the_end() -> None:
    air, lost = Airspace(), ghost(path=[(0.0, 0.0), (10.0, 0.0)], last=(5.0, 0.0), home=(0.0, -50.0))
    over_there = {"uav-1": [(100.0, -20.0), (100.0, 20.0)]}
    air.reserve(lost)
    assert air.conflicts(over_there, [0.0, 5.0], 4.0) == []
    air.release("uav-3")
    air.reserve(replace(lost, rally_m=((300.0, 0.0),)))
    [conflict] = air.conflicts(over_there, [0.0, 5.0], 4.0)
    assert conflict.because == "the way home"
    assert conflict.apart_m == pytest.approx(0.0)
    away = {"uav-1": [(2.0, 40.0), (12.0, 40.0)]}
    air.release("uav-3")
    air.reserve(replace(lost, rally_m=((10.0, 90.0),)))
    [conflict] = air.conflicts(away, [100.0, 105.0], 4.0)
    assert conflict.apart_m < 1.0


def test_reserved_air_that_was_stored_without_rally_points_has_none() -> None:
    air, again = Airspace(), Airspace()
    air.reserve(ghost(path=[(0.0, 0.0), (10.0, 5.0)], home=(1.0, 2.0)))
    [stored] = air.document()
    del stored["rally_m"]
    again.recall([stored])
    assert again.document() == air.document()


def test_reserved_air_is_recalled_as_it_was() -> None:
    air, again = Airspace(), Airspace()
    air.reserve(replace(ghost(path=[(0.0, 0.0), (10.0, 5.0)], home=(1.0, 2.0)), rally_m=((7.0, 8.0),)))
    air.seen("uav-3", (3.0, 4.0))
    again.recall(json.loads(json.dumps(air.document())))
    assert again.document() == air.document()
    flown = {"uav-1": [(3.0, 0.0), (3.0, 8.0)]}
    assert again.conflicts(flown, [0.0, 5.0], 4.0) == air.conflicts(flown, [0.0, 5.0], 4.0) != []


def closest(first: list[Point], second: list[Point], times: list[float]) -> tuple[float, float]:
    """(least distance, when), leg by leg with the formula for a point and a line."""
    found = []
    between = [(a[0] - b[0], a[1] - b[1]) for a, b in zip(first, second, strict=True)]
    for (start, end), (begin, stop) in zip(pairwise(between), pairwise(times), strict=True):
        east, north = end[0] - start[0], end[1] - start[1]
        length2 = east**2 + north**2
        share = 0.0 if length2 == 0 else min(1.0, max(0.0, -(start[0] * east + start[1] * north) / length2))
        found.append((hypot(start[0] + share * east, start[1] + share * north), begin + share * (stop - begin)))
    return min(found)


@given(ways=st.lists(st.lists(st.tuples(*[st.integers(-9, 9).map(float)] * 2), min_size=3, max_size=3), max_size=5))
def test_the_first_two_of_a_fleet_that_come_too_close_are_named(ways: list[list[Point]]) -> None:
    named, times = {f"uav-{number}": way for number, way in enumerate(ways)}, [2.0, 5.0, 10.0]
    near = [
        (one, two, *found)
        for one, two in combinations(named, 2)
        if (found := closest(named[one], named[two], times))[0] < 4.0
    ]
    live, paths = {uav: way[0] for uav, way in named.items()}, {uav: way[1:] for uav, way in named.items()}
    if not near:
        check_transition(live, paths, **HOW)
        return
    one, two, apart_m, _ = near[0]
    with pytest.raises(TransitionTooClose, match=f"'{one}' and '{two}' would come within {apart_m:.2f} m") as refused:
        check_transition(live, paths, **HOW)
    at = float(str(refused.value).split(" at ")[1].split(" s")[0])
    here, there = (place_at(min(at, 10.0), times, named[uav]) for uav in (one, two))
    assert hypot(here[0] - there[0], here[1] - there[1]) == pytest.approx(apart_m, abs=1.5)  # `at` is rounded to 0.1 s


@given(
    ends=st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=4, max_size=4),
    later=st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=2),
)
def test_what_is_let_through_keeps_apart_at_every_moment(ends: list[Point], later: list[Point]) -> None:
    live = {"uav-1": ends[0], "uav-2": ends[1]}
    paths = {"uav-1": [ends[2], later[0]], "uav-2": [ends[3], later[1]]}
    try:
        check_transition(live, paths, **HOW)
    except TransitionTooClose:
        return
    times = [2.0, 5.0, 10.0]
    for step in range(81):
        now = 2.0 + step * 0.1
        one, two = (place_at(now, times, [live[uav], *paths[uav]]) for uav in live)
        assert ((one[0] - two[0]) ** 2 + (one[1] - two[1]) ** 2) ** 0.5 >= 4.0 - 1e-9


def place_at(now: float, times: list[float], way: list[Point]) -> Point:
    leg = 0 if now < times[1] else 1
    share = (now - times[leg]) / (times[leg + 1] - times[leg])
    (e0, n0), (e1, n1) = way[leg], way[leg + 1]
    return e0 + share * (e1 - e0), n0 + share * (n1 - n0)


@pytest.mark.parametrize(
    ("lost", "because"),
    [
        (ghost(path=[(30.0, 0.0), (0.0, 0.0), (0.0, 0.0)]), "the old route"),
        (ghost(path=[(500.0, 500.0)] * 3, last=(10.0, 1.0)), "the last place"),
        (ghost(path=[(500.0, 500.0)] * 3, home=(-480.0, -480.0)), "the way home"),
    ],
    ids=["flies on", "hovers", "returns"],
)
def test_the_air_of_a_lost_uav_is_taken_however_it_behaves(lost: Ghost, because: str) -> None:
    airspace = Airspace()
    airspace.reserve(lost)
    live, paths = {"uav-1": (0.0, 0.0)}, {"uav-1": [(20.0, 0.0)]}
    with pytest.raises(TransitionTooClose, match=f"{because} of 'uav-3'"):
        check_transition(live, paths, airspace=airspace, **HOW)
    airspace.release("uav-3")  # seen on the ground
    check_transition(live, paths, airspace=airspace, **HOW)


def test_the_last_place_of_a_lost_uav_that_is_still_heard_is_where_it_is_now() -> None:
    airspace = Airspace()
    airspace.reserve(ghost(path=[(500.0, 500.0)] * 3, last=(10.0, 1.0)))
    airspace.seen("uav-3", (10.0, 41.0))  # a human flies it
    check_transition({"uav-1": (0.0, 0.0)}, {"uav-1": [(20.0, 0.0)]}, airspace=airspace, **HOW)
    with pytest.raises(TransitionTooClose, match="the last place of 'uav-3'"):
        check_transition({"uav-1": (0.0, 40.0)}, {"uav-1": [(20.0, 40.0)]}, airspace=airspace, **HOW)
    airspace.seen("uav-2", (0.0, 0.0))  # whose air is not reserved
    assert set(airspace.ghosts) == {"uav-3"}


def test_a_ghost_is_reserved_until_its_deadline_and_no_longer() -> None:
    airspace = Airspace()
    airspace.reserve(ghost(path=[(0.0, 0.0)] * 2))
    assert airspace.expire(599.0) == []
    assert airspace.expire(600.0) == ["uav-3"]
    assert airspace.ghosts == {}


def test_at_another_time_the_old_route_is_free() -> None:
    airspace = Airspace()
    airspace.reserve(ghost(path=[(0.0, 0.0), (100.0, 0.0), (200.0, 0.0), (200.0, 300.0)]))
    check_transition({"uav-1": (0.0, 0.0)}, {"uav-1": [(20.0, 0.0)]}, airspace=airspace, **HOW)
