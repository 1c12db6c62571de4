"""Wind and energy of a fleet: what is bounded is bounded, and the kernels calculate the same."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES, Scenario
from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import account_of
from skyfolio.planner.energy.air import Air
from skyfolio.planner.energy.power import law_of
from skyfolio.planner.fast.air import Breeze, breeze_of, home_wh, left_wh, longest, slot_wh
from skyfolio.planner.fast.jit import entry
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import Battery, RallyPoint, Rotors, Wind

speeds = st.floats(0.0, 25.0)
winds, moves = st.floats(-6.0, 6.0), st.floats(-20.0, 20.0).map(lambda metres: round(metres, 6))


def windy(east: float = 4.0, north: float = -3.0, gust: float = 1.5, **changes: object) -> Scenario:
    easy = EXAMPLES["minimal"]()
    more = {"max_speed_mps": 9.0, "max_airspeed_mps": 11.0, "battery": Battery(usable_wh=40.0)}
    return easy.with_changes(
        uavs=tuple(uav.model_copy(update={**more, **changes}) for uav in easy.uavs),
        wind=Wind(east_mps=east, north_mps=north, gust_mps=gust),
    )


def air_of(scenario: Scenario) -> Air:
    assert scenario.air is not None
    return scenario.air


@given(speeds, st.floats(0.0, 6.0), st.floats(0.0, 1.0))
def test_no_airspeed_within_a_gust_takes_more_than_the_bound(airspeed: float, gust: float, share: float) -> None:
    law = law_of([Rotors(), Rotors(blade_w=10.0, induced_w=300.0, induced_mps=9.0)])
    inside = max(0.0, airspeed - gust) + share * (airspeed + gust - max(0.0, airspeed - gust))
    assert (law.expected_w(np.full(2, inside)) <= law.worst_w(np.full(2, airspeed), gust) * (1 + 1e-12)).all()


def test_hovering_in_still_air_takes_what_zeng_gives() -> None:
    law = law_of([Rotors()])
    assert law.expected_w(np.zeros(1))[0] == pytest.approx(79.86 + 88.63)


@given(st.floats(0.0, 2 * np.pi), st.floats(-6.7, 6.7), st.floats(-6.7, 6.7), st.floats(0.0, 1.5))
def test_the_longest_step_is_at_one_of_its_limits_and_within_both(
    angle: float, east: float, north: float, gust: float
) -> None:
    air = air_of(windy(east, north, gust))
    towards = np.array([np.cos(angle), np.sin(angle)])
    speed = air.longest_m(np.tile(towards, (2, 1, 1)))[0, 0] / air.slot_s
    airspeed = float(np.linalg.norm(towards * speed - air.wind_mps))
    assert speed <= 9.0
    assert airspeed + gust <= 11.0 + 1e-9
    assert speed == pytest.approx(9.0) or airspeed + gust == pytest.approx(11.0, abs=1e-6)


def test_a_headwind_bounds_the_step_and_a_tailwind_does_not_beyond_the_ground_speed() -> None:
    air = air_of(windy(east=6.0, north=0.0, gust=1.0))
    east, west = np.array([[[1.0, 0.0]]] * 2), np.array([[[-1.0, 0.0]]] * 2)
    assert air.longest_m(east)[0, 0] == pytest.approx(9.0 * air.slot_s)
    assert air.longest_m(west)[0, 0] == pytest.approx((11.0 - 1.0 - 6.0) * air.slot_s)


def test_the_way_home_is_flown_to_the_cheapest_place_to_land() -> None:
    scenario = windy(east=6.0, north=0.0)
    near = scenario.with_changes(rally_points=(RallyPoint(position_m=(195.0, 50.0)),))
    far_east = np.array([[[190.0, 50.0]]] * 2)
    assert air_of(near).home_wh(far_east)[0, 0] < air_of(scenario).home_wh(far_east)[0, 0]


def test_no_way_home_against_a_wind_that_is_too_strong_costs_more_than_any_battery() -> None:
    air = air_of(windy(east=9.5, north=0.0, gust=1.5 - 1e-7))
    assert air.home_wh(np.array([[[150.0, 50.0]]] * 2))[0, 0] > 1e5


@entry
def _in_kernels(breeze: Breeze, u: int, x: float, y: float, dx: float, dy: float) -> tuple[float, float, float, float]:
    """What the kernels make of one step."""
    home = home_wh(breeze, u, x, y)
    left, _ = left_wh(breeze, u, 10.0, home, x, y, dx, dy)
    return longest(breeze, u, breeze.step[u], dx, dy), slot_wh(breeze, u, dx, dy), home, left


@given(winds, winds, st.floats(0.0, 200.0), moves, moves)
def test_kernels_calculate_what_the_tables_do(east: float, north: float, x: float, dx: float, dy: float) -> None:
    scenario = windy(east, north)
    air, breeze = air_of(scenario), breeze_of(problem_of(scenario))
    step, spent, home, left = _in_kernels(breeze, 1, x, 40.0, dx, dy)

    def both(east: float, north: float) -> Array:
        return np.array([[[east, north]]] * 2)

    assert step == pytest.approx(air.longest_m(both(dx, dy))[1, 0], rel=1e-9) or (dx, dy) == (0.0, 0.0)
    assert spent == pytest.approx(air.spent_wh(both(dx, dy), proven=True)[1, 0])
    before, after = air.home_wh(both(x, 40.0))[1, 0], air.home_wh(both(x + dx, 40.0 + dy))[1, 0]
    assert home + air.landing_wh[1] == pytest.approx(before)
    assert left == pytest.approx(10.0 - (spent - air.hover_wh()[1] + after - before), abs=1e-9)


@given(st.integers(0, 10_000))
def test_no_path_uses_up_more_than_its_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenario = windy(*rng.uniform(-5, 5, 2))
    air, n_slots = air_of(scenario), scenario.slots
    moves = rng.normal(size=(2, n_slots, 2))
    steps = moves * (air.longest_m(moves) * rng.random((2, n_slots)) / np.linalg.norm(moves, axis=-1))[..., None]
    starts = np.array([uav.start_m for uav in scenario.uavs], dtype=float)
    ended = starts + steps.sum(axis=1)
    more = (air.spent_wh(steps, proven=True) - air.hover_wh()[:, None]).sum(axis=1)
    home = air.home_wh(ended[:, None])[:, 0] - air.home_wh(starts[:, None])[:, 0]
    extent = np.linalg.norm(ended - air.homes_m[:, 0], axis=1)
    assert (more + home <= air.most_spare_used_wh(n_slots, extent) + 1e-9).all()


def test_the_account_of_a_hover_is_worked_by_hand() -> None:
    rotors = Rotors(blade_w=100.0, induced_w=80.0, climb_w_per_mps=20.0, climb_mps=2.0, descend_mps=1.0)
    easy = EXAMPLES["minimal"]()
    scenario = easy.with_changes(
        altitude_m=60.0,
        uavs=tuple(
            uav.model_copy(update={"rotors": rotors, "battery": Battery(usable_wh=40.0, reserve_share=0.25)})
            for uav in easy.uavs
        ),
    )
    paths = np.array([[uav.start_m] * scenario.slots for uav in scenario.uavs], dtype=float)
    account = account_of(air_of(scenario), paths, np.full(2, scenario.slots))
    climb = 180.0 * 30.0 + 20.0 * 60.0
    used = (climb + 180.0 * scenario.slot_duration_s * np.arange(1, scenario.slots + 1)) / 3600.0
    assert account.used_wh[0] == pytest.approx(used)
    assert account.margin_wh[0] == pytest.approx(30.0 - used - 180.0 * 60.0 / 3600.0)
