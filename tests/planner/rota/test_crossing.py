"""Ways of one UAV while the others fly theirs: early, clear of everybody, out of zones, as fast as wind allows."""

from itertools import pairwise
from math import dist
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES, Scenario, Uav
from skyfolio.planner.arrays import Array
from skyfolio.planner.feasibility import no_fly_depth_m
from skyfolio.planner.rota.crossing import Arrival, beside, crossing
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, Wind
from skyfolio.planner.separation import closest_approach

UAV = Uav(id="a", start_m=(0.0, 50.0), max_speed_mps=4.0)
NOBODY = np.zeros((0, 40, 2))


def field(**changes: Any) -> Scenario:
    """A field of 200 m by 100 m; a step is 20 m."""
    fields: dict[str, Any] = {
        "area_m": ((0.0, 0.0), (200.0, 100.0)),
        "slots": 40,
        "slot_duration_s": 5.0,
        "min_separation_m": 8.0,
        "uavs": (UAV,),
        **changes,
    }
    return EXAMPLES["minimal"]().with_changes(**fields)


def hovering(*places: tuple[float, float], slots: int = 40) -> Array:
    return np.repeat(np.array(places, dtype=float)[:, None], slots, axis=1)


def test_a_free_way_is_straight_and_as_fast_as_it_can_be() -> None:
    found = crossing(field(), UAV, (0.0, 50.0), (110.0, 50.0), NOBODY)
    assert found is not None
    assert found.slot == 6
    assert found.path_m[:, 1] == pytest.approx(50.0)
    assert np.diff(found.path_m[:7, 0]) == pytest.approx(110.0 / 6)
    assert (found.path_m[6:] == (110.0, 50.0)).all()


def test_who_hovers_in_the_way_is_gone_around() -> None:
    others = hovering((60.0, 50.0))
    found = crossing(field(), UAV, (0.0, 50.0), (120.0, 50.0), others)
    assert found is not None
    assert found.slot <= 8
    assert closest_approach(np.concatenate([others, found.path_m[None]])) >= 8.0


def test_who_passes_is_waited_for() -> None:
    """In a corridor as narrow as two UAVs' distance there is no way around: one comes towards it, and turns off."""
    narrow = field(area_m=((0.0, 46.0), (200.0, 54.0)))
    other = np.array([[(40.0, 50.0)] * 5 + [(40.0 + 10.0 * n, 50.0) for n in range(35)]])[:, :40].clip(max=200.0)
    found = crossing(narrow, UAV, (0.0, 50.0), (120.0, 50.0), other)
    assert found is not None
    assert closest_approach(np.concatenate([other, found.path_m[None]])) >= 8.0
    assert found.slot > 6


def test_who_has_left_is_in_nobodys_way_and_who_stays_for_good_blocks() -> None:
    narrow = field(area_m=((0.0, 46.0), (200.0, 54.0)))
    other = hovering((60.0, 50.0))
    assert crossing(narrow, UAV, (0.0, 50.0), (120.0, 50.0), other) is None
    other[:, 10:] = np.nan
    found = crossing(narrow, UAV, (0.0, 50.0), (120.0, 50.0), other)
    assert found is not None
    assert found.path_m[:10, 0].max() <= 60.0 - 8.0


def test_a_place_that_is_taken_is_reached_when_it_is_free() -> None:
    other = hovering((120.0, 50.0))
    other[:, 20:] = np.nan
    found = crossing(field(), UAV, (0.0, 50.0), (120.0, 50.0), other)
    assert found is not None
    assert found.slot >= 20


def test_a_place_that_is_passed_later_is_only_reached_by_who_need_not_stay() -> None:
    other = np.array([[(120.0, 0.0)] * 12 + [(120.0, min(10.0 * n, 100.0)) for n in range(28)]])
    through = crossing(field(), UAV, (0.0, 50.0), (120.0, 50.0), other, stays=False)
    staying = crossing(field(), UAV, (0.0, 50.0), (120.0, 50.0), other)
    assert through is not None
    assert staying is not None
    assert (through.slot, staying.slot > 16) == (7, True)  # a step is a hair below 20 m


def test_it_waits_until_the_slot_from_which_on_it_may_go() -> None:
    found = crossing(field(), UAV, (0.0, 50.0), (35.0, 50.0), NOBODY, from_slot=5)
    assert found is not None
    assert found.slot == 7
    assert (found.path_m[:6] == (0.0, 50.0)).all()


@pytest.mark.parametrize(
    "zone",
    [
        NoFlyDisc(center_m=(60.0, 50.0), radius_m=20.0),
        NoFlyPolygon(vertices_m=((50.0, 20.0), (70.0, 20.0), (70.0, 90.0), (50.0, 90.0))),
    ],
)
def test_a_zone_is_gone_around(zone: NoFlyDisc | NoFlyPolygon) -> None:
    found = crossing(field(no_fly=(zone,)), UAV, (0.0, 50.0), (120.0, 50.0), NOBODY)
    assert found is not None
    legs = [((a[0], a[1]), (b[0], b[1])) for a, b in pairwise(found.path_m.tolist())]
    assert max(no_fly_depth_m(zone, here, there) for here, there in legs) <= 0.0


def test_no_way_leads_through_a_wall_of_zones() -> None:
    wall = NoFlyPolygon(vertices_m=((50.0, -10.0), (70.0, -10.0), (70.0, 110.0), (50.0, 110.0)))
    assert crossing(field(no_fly=(wall,)), UAV, (0.0, 50.0), (120.0, 50.0), NOBODY) is None


def test_against_the_wind_it_takes_longer_and_in_too_much_wind_there_is_no_way() -> None:
    windy = field(wind=Wind(east_mps=-2.0))
    uav = UAV.model_copy(update={"max_speed_mps": 20.0, "max_airspeed_mps": 4.0})
    there, back = (
        crossing(windy, uav, here, end, NOBODY)
        for here, end in (((0.0, 50.0), (100.0, 50.0)), ((100.0, 50.0), (0.0, 50.0)))
    )
    assert there is not None
    assert back is not None
    assert (there.slot, back.slot) == (11, 4)
    assert crossing(field(), UAV.model_copy(update={"max_speed_mps": 0.0}), (0.0, 50.0), (9.0, 9.0), NOBODY) is None


def test_a_spot_beside_a_station_is_free_and_on_the_side_of_arrival() -> None:
    spots = list(beside(field(), (100.0, 50.0), (0.0, 50.0), hovering((100.0, 50.0))))
    assert spots[0] == pytest.approx((88.0, 50.0))
    assert min(dist(spot, (100.0, 50.0)) for spot in spots) >= 1.5 * 8.0 - 1e-9
    taken = list(beside(field(), (100.0, 50.0), (0.0, 50.0), hovering((100.0, 50.0), (88.0, 50.0))))
    assert taken[0] != pytest.approx((88.0, 50.0))
    assert all(dist(spot, (88.0, 50.0)) >= 8.0 for spot in taken)
    assert all(spot[0] >= 0.0 for spot in beside(field(), (2.0, 50.0), (0.0, 50.0), NOBODY))
    assert list(beside(field(min_separation_m=0.0), (2.0, 50.0), (0.0, 0.0), NOBODY)) == [(2.0, 50.0)]


@st.composite
def skies(draw: st.DrawFn) -> tuple[Scenario, tuple[float, float], tuple[float, float], Array]:
    """Fields with zones and wind, and others that fly and leave."""
    rng = np.random.default_rng(draw(st.integers(0, 100_000)))
    zones = tuple(
        NoFlyDisc(
            center_m=(float(rng.uniform(30, 170)), float(rng.uniform(0, 100))), radius_m=float(rng.uniform(3, 25))
        )
        for _ in range(draw(st.integers(0, 3)))
    )
    wind = draw(st.sampled_from((None, Wind(east_mps=1.0, north_mps=-1.0, gust_mps=0.5))))
    scenario = field(wind=wind, slots=40)
    others = np.empty((draw(st.integers(0, 4)), 40, 2))
    for row in others:
        stops = rng.uniform((0, 0), (200, 100), size=(5, 2))
        row[:] = np.array([np.interp(np.arange(40), np.linspace(0, 39, 5), stops[:, axis]) for axis in (0, 1)]).T
        row[draw(st.sampled_from((20, 40))) :] = np.nan
    here, there = ((float(rng.uniform(0, 20)), float(rng.uniform(0, 100))), (180.0, float(rng.uniform(0, 100))))
    free = tuple(zone for zone in zones if min(dist(zone.center_m, place) for place in (here, there)) > zone.radius_m)
    return scenario.model_copy(update={"no_fly": free}), here, there, others


@given(skies(), st.integers(0, 6), st.booleans())
@settings(max_examples=120)
def test_every_way_that_is_found_keeps_every_rule(
    sky: tuple[Scenario, tuple[float, float], tuple[float, float], Array], from_slot: int, stays: bool
) -> None:
    scenario, here, there, others = sky
    found = crossing(scenario, UAV, here, there, others, from_slot=from_slot, stays=stays)
    if found is None:
        return
    require_flyable(scenario, found, here, there, from_slot)
    until = 40 if stays else found.slot + 1
    for row in others:
        flown = min(until, 40 if not np.isnan(row[-1, 0]) else 20)
        pair = np.stack([row[from_slot:flown], found.path_m[from_slot:flown]])
        if from_slot + 1 < flown and dist(pair[0, 0], pair[1, 0]) >= 8.0:  # it cannot help where it begins
            assert closest_approach(pair) >= 8.0
    assert crossing(scenario, UAV, here, there, others, from_slot=from_slot, stays=stays).slot == found.slot  # type: ignore[union-attr]


def require_flyable(
    scenario: Scenario, found: Arrival, here: tuple[float, float], there: tuple[float, float], from_slot: int
) -> None:
    assert (found.path_m[: from_slot + 1] == here).all()
    assert (found.path_m[found.slot :] == there).all()
    limit = scenario.wind
    for a, b in pairwise(found.path_m.tolist()):
        step = np.subtract(b, a) / 5.0
        assert np.hypot(*step) <= 4.0 + 1e-9
        if limit is not None:
            assert np.hypot(step[0] - limit.east_mps, step[1] - limit.north_mps) + limit.gust_mps <= 4.0 + 1e-9
        assert all(no_fly_depth_m(zone, (a[0], a[1]), (b[0], b[1])) <= 1e-9 for zone in scenario.no_fly)
        assert 0.0 <= b[0] <= 200.0
        assert 0.0 <= b[1] <= 100.0
