"""Altitude off plan and a home that moves: told once when it lasts, and once when it is over."""

from __future__ import annotations

from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.mavlink_bridge.deviations import AltitudeOffPlan, AltitudeWatch, Deviation, HomeMoved, HomeWatch

HOME = (47.397742, 8.545594)
TEN_M_NORTH = (47.397832, 8.545594)


def told_of(altitudes_m: list[float], step_s: float = 0.5) -> list[tuple[float, Deviation]]:
    watch = AltitudeWatch(Altitudes((60.0, 60.0)), 5.0)
    looks = [(n * step_s, watch.look(n * step_s, up_m, 488.0 + up_m)) for n, up_m in enumerate(altitudes_m)]
    return [(at_s, said) for at_s, said in looks if said is not None]


def test_twelve_metres_for_twelve_seconds_are_told_when_they_begin_to_last_and_when_they_are_over() -> None:
    told = told_of([60.0] * 20 + [48.0] * 24 + [60.0] * 20)
    assert told == [(13.0, AltitudeOffPlan(True, -12.0)), (25.0, AltitudeOffPlan(False, 0.0))]


def test_over_terrain_it_is_judged_above_sea_level_on_the_climb_that_is_planned() -> None:
    climbs = Altitudes((500.0, 505.0, 510.0, 515.0, 520.0), amsl=True)
    watch, late = AltitudeWatch(climbs, 5.0), AltitudeWatch(climbs, 5.0)
    assert [watch.look(at_s, 12.0, 500.0 + at_s) for at_s in range(20)] == [None] * 20
    told = [said for at_s in range(20) if (said := late.look(at_s, 12.0, 500.0)) is not None]
    assert told == [AltitudeOffPlan(True, -9.0)]


def test_a_gust_and_an_altitude_between_the_limits_are_not_worth_an_event() -> None:
    assert told_of([60.0] * 20 + [68.0] * 4 + [63.5] * 40) == []


def test_at_the_edge_of_the_limit_it_is_told_once() -> None:
    assert len(told_of([60.0] * 20 + [65.5, 64.5] * 5 + [66.0] * 10 + [64.0, 62.5] * 20)) == 1


def test_a_climb_to_the_altitude_of_a_new_mission_is_no_deviation() -> None:
    assert told_of([50.0, 51.0, 52.0, 53.0, 54.0, 55.0, 56.0, 57.0, 58.0, 59.0] + [60.0] * 30) == []


def test_a_home_that_moves_is_told_once_with_how_far() -> None:
    watch = HomeWatch()
    assert watch.look(None, None) is None
    assert watch.look(HOME, 488.0) is None
    assert watch.look((HOME[0] + 1e-5, HOME[1]), 489.0) is None  # a metre: GPS wanders
    moved = watch.look(TEN_M_NORTH, 488.0)
    assert moved is not None
    assert (round(moved.moved_m), moved.up_m) == (10, 0.0)
    assert watch.look(TEN_M_NORTH, 488.0) is None
    assert watch.look(TEN_M_NORTH, 500.0) == HomeMoved(0.0, 12.0)
