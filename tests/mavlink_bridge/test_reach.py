"""Where a first leg from rest ends: against a numerical integration, and what limits it."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import VehicleModel
from skyfolio.mavlink_bridge.ardupilot import ARDUCOPTER_MODEL as ARDUCOPTER
from skyfolio.mavlink_bridge.pace import fastest_on_leg, mean_acceleration, way_from_rest_m
from skyfolio.mavlink_bridge.px4 import PX4_MODEL as PX4
from skyfolio.mavlink_bridge.reach import UNDER_WAY_S, first_leg_miss, head_start_s


def integrated_m(speed_mps: float, time_s: float, model: VehicleModel) -> float:
    """The same by small steps: the acceleration builds up, stays, and fades so that it ends at the speed."""
    dt, way, speed, acceleration, at = 0.0005, 0.0, 0.0, 0.0, 0.0
    while at < time_s:
        if model.jerk_mps3 == inf:
            acceleration = model.acceleration_mps2 if speed < speed_mps else 0.0
        else:
            fades = speed + acceleration**2 / (2 * model.jerk_mps3) >= speed_mps
            change = -model.jerk_mps3 if fades else model.jerk_mps3
            acceleration = min(max(acceleration + change * dt, 0.0), model.acceleration_mps2)
        speed += acceleration * dt
        way += speed * dt
        at += dt
    return way


@given(
    speed_mps=st.floats(0.5, 15.0),
    time_s=st.floats(0.1, 8.0),
    jerk_mps3=st.sampled_from([0.5, 1.0, 4.0, 20.0, inf]),
)
def test_the_way_from_rest_is_that_of_a_numerical_integration(
    speed_mps: float, time_s: float, jerk_mps3: float
) -> None:
    model = replace(PX4, jerk_mps3=jerk_mps3)
    assert way_from_rest_m(speed_mps, time_s, model) == pytest.approx(
        integrated_m(speed_mps, time_s, model), abs=0.05, rel=0.01
    )


@given(distance_m=st.floats(0.5, 300.0))
def test_the_fastest_speed_on_a_leg_from_rest_to_rest_uses_all_of_it(distance_m: float) -> None:
    speed = fastest_on_leg(distance_m, ARDUCOPTER)
    needed_m = speed**2 / mean_acceleration(speed, ARDUCOPTER.acceleration_mps2, ARDUCOPTER.jerk_mps3)
    assert speed == pytest.approx(ARDUCOPTER.max_speed_mps) or needed_m == pytest.approx(distance_m, rel=1e-3)
    assert fastest_on_leg(distance_m, PX4) == PX4.max_speed_mps


def test_the_first_leg_that_moves_is_the_one_that_counts() -> None:
    missed = first_leg_miss([(0.0, 0.0)] * 3 + [(40.0, 0.0), (40.0, 40.0)], 5.0, ARDUCOPTER)
    assert missed is not None
    assert (missed.slot, missed.leg_m) == (3, 40.0)
    assert missed.miss_m > 8.0
    assert first_leg_miss([(0.0, 0.0)] * 4, 5.0, ARDUCOPTER) is None


def test_who_hardly_moves_at_first_sets_out_before_its_slot_and_no_sooner_than_a_metre_allows() -> None:
    path = [(0.0, 0.0), (25.0, 0.0), (25.0, 25.0)]
    ahead_s = head_start_s(path, 0, 5.0, ARDUCOPTER)
    assert ahead_s == pytest.approx(1.82, abs=0.01)
    assert way_from_rest_m(ARDUCOPTER.max_speed_mps, ahead_s, ARDUCOPTER) <= 1.0 + 1e-9
    missed = first_leg_miss(path, 5.0, ARDUCOPTER)
    assert missed is not None
    assert missed.miss_m < 5.0  # without, measured on ArduCopter 4.6: 11.6 m
    assert head_start_s([(0.0, 0.0), (5.0, 0.0)], 0, 5.0, ARDUCOPTER) == 0.0
    assert head_start_s(path, 2, 5.0, ARDUCOPTER) == 0.0  # nowhere to go


@pytest.mark.parametrize(
    ("time_s", "flown_m"),
    [(0.89, 0.3), (1.49, 1.2), (2.10, 2.8), (2.70, 5.1), (3.31, 7.9), (3.91, 11.2), (4.52, 14.8)],
)
def test_px4_leaves_rest_as_real_ones_did(time_s: float, flown_m: float) -> None:
    """Metres flown after mode MISSION began, mean of two quads in software-in-the-loop (PX4 1.18)."""
    assert way_from_rest_m(8.4, time_s - UNDER_WAY_S, PX4.departing()) == pytest.approx(flown_m, abs=1.0)


def test_a_px4_sets_out_before_its_slot_too_and_a_leg_it_cannot_fly_in_time_is_known() -> None:
    path = [(0.0, 0.0), (25.0, 0.0), (25.0, 25.0)]
    assert head_start_s(path, 0, 5.0, PX4) == pytest.approx(0.58, abs=0.02)
    assert head_start_s([(0.0, 0.0), (10.0, 0.0)], 0, 5.0, PX4) == 0.0
    missed = first_leg_miss([(0.0, 0.0), (40.0, 0.0), (40.0, 40.0)], 5.0, PX4)
    assert missed is not None
    assert missed.miss_m > 8.0
