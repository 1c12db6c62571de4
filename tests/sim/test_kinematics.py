"""sim.kinematics"""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.sim.kinematics import Body, Guidance, Limits, approach_speed, fall, step, stopping_point

DT = 0.05
EPSILON = 1e-6
places = st.floats(-500.0, 500.0)
guidances = st.builds(
    Guidance,
    east_m=places,
    north_m=places,
    up_m=st.floats(0.0, 150.0),
    speed_mps=st.floats(0.1, 30.0),
    passing_mps=st.floats(0.0, 30.0),
    landing=st.booleans(),
    velocity_mps=st.none(),
    yaw_rad=st.none(),
)
limits_of_all_kinds = st.builds(
    Limits,
    max_speed_mps=st.floats(1.0, 20.0),
    acceleration_mps2=st.floats(0.5, 8.0),
    climb_mps=st.floats(0.5, 6.0),
    descend_mps=st.floats(0.7, 4.0),
    land_mps=st.floats(0.3, 0.7),
)


def fly(body: Body, guidance: Guidance, limits: Limits, seconds: float) -> Body:
    for _ in range(round(seconds / DT)):
        body = step(body, guidance, limits, DT)
    return body


@given(limits=limits_of_all_kinds, orders=st.lists(st.tuples(guidances, st.integers(1, 40)), min_size=1, max_size=8))
def test_no_order_of_guidance_makes_it_exceed_its_speeds_or_accelerations(
    limits: Limits, orders: list[tuple[Guidance, int]]
) -> None:
    body = Body(up_m=100.0)
    for guidance, steps in orders:
        for _ in range(steps):
            after = step(body, guidance, limits, DT)
            change = math.hypot(after.east_mps - body.east_mps, after.north_mps - body.north_mps)
            moved = math.hypot(after.east_m - body.east_m, after.north_m - body.north_m)
            if not after.on_ground:
                assert change <= limits.acceleration_mps2 * DT + EPSILON
                assert after.up_mps - body.up_mps <= limits.climb_acceleration_mps2 * DT + EPSILON
                assert body.up_mps - after.up_mps <= limits.descend_acceleration_mps2 * DT + EPSILON
            assert after.ground_speed_mps <= limits.max_speed_mps + EPSILON
            assert moved <= limits.max_speed_mps * DT + EPSILON
            assert -limits.descend_mps - EPSILON <= after.up_mps <= limits.climb_mps + EPSILON
            assert after.up_m >= 0.0
            body = after


@given(east=places, north=places, up=st.floats(1.0, 150.0), speed=st.floats(1.0, 12.0))
def test_it_arrives_at_any_point_and_stays_there(east: float, north: float, up: float, speed: float) -> None:
    start = Body(up_m=30.0)
    seconds = math.hypot(east, north) / speed + abs(up - 30.0) / 1.5 + 20.0
    body = fly(start, Guidance(east, north, up, speed), Limits(), seconds)
    assert body.distance_to(east, north) < 0.05
    assert body.up_m == pytest.approx(up, abs=0.05)
    assert body.ground_speed_mps < 0.05


def test_it_does_not_overshoot_a_stop() -> None:
    body, furthest = Body(up_m=20.0), 0.0
    for _ in range(400):
        body = step(body, Guidance(50.0, 0.0, 20.0, 12.0), Limits(), DT)
        furthest = max(furthest, body.east_m)
    assert 49.95 < furthest < 50.05


def test_a_leg_from_rest_to_rest_takes_about_what_physics_says() -> None:
    limits, body, seconds = Limits(), Body(up_m=20.0), 0.0
    while body.distance_to(25.0, 0.0) > 0.5:
        body, seconds = step(body, Guidance(25.0, 0.0, 20.0, 5.0), limits, DT), seconds + DT
    ideal = 25.0 / 5.0 + 5.0 / 2.0 * (1.0 / 3.0 + 1.0 / 3.0)
    last_half_metre = math.sqrt(2.0 * 0.5 / 3.0)
    assert ideal - last_half_metre < seconds < ideal + 1.0


def test_a_point_to_be_passed_is_passed_at_the_given_speed() -> None:
    body = Body(up_m=20.0)
    while body.east_m < 39.5:
        body = step(body, Guidance(40.0, 0.0, 20.0, 8.0, passing_mps=3.0), Limits(), DT)
    assert body.ground_speed_mps == pytest.approx(3.0, abs=0.4)


def test_landing_slows_down_below_ten_metres_and_ends_on_the_ground() -> None:
    limits, landing = Limits(), Guidance(0.0, 0.0, 0.0, 5.0, landing=True)
    body = fly(Body(up_m=30.0), landing, limits, 5.0)
    assert body.up_mps == pytest.approx(-1.5)
    body = fly(body, landing, limits, 10.0)
    assert body.up_m < 10.0
    assert body.up_mps == pytest.approx(-0.7)
    body = fly(body, landing, limits, 20.0)
    assert body.on_ground
    assert (body.up_mps, body.ground_speed_mps) == (0.0, 0.0)


def test_it_turns_its_nose_into_its_course_at_a_limited_rate() -> None:
    body = fly(Body(up_m=20.0), Guidance(-200.0, 0.0, 20.0, 5.0), Limits(), 0.5)
    assert abs(body.yaw_rad) < math.radians(31.0)
    body = fly(body, Guidance(-200.0, 0.0, 20.0, 5.0), Limits(), 5.0)
    assert body.yaw_rad == pytest.approx(-math.pi / 2.0)


def test_without_power_it_falls_like_a_stone_and_rests_where_it_hits() -> None:
    body, seconds = Body(up_m=19.62, east_mps=5.0), 0.0
    while not body.on_ground:
        body, seconds = fall(body, DT), seconds + DT
    assert seconds == pytest.approx(2.0, abs=0.1)
    assert body.east_m == pytest.approx(10.0, abs=0.5)
    rest = fall(body, DT)
    assert (rest.up_m, rest.up_mps, rest.ground_speed_mps) == (0.0, 0.0, 0.0)


def test_the_stopping_point_is_where_it_really_stops() -> None:
    moving = fly(Body(up_m=20.0), Guidance(500.0, 0.0, 20.0, 10.0), Limits(), 8.0)
    east, north = stopping_point(moving, Limits())
    stopped = fly(moving, Guidance(east, north, 20.0, 10.0), Limits(), 15.0)
    assert stopped.distance_to(east, north) < 0.05


@given(distance=st.floats(0.0, 1000.0), acceleration=st.floats(0.1, 10.0))
def test_the_approach_speed_can_always_be_braked_away(distance: float, acceleration: float) -> None:
    speed = approach_speed(distance, acceleration)
    assert speed**2 <= 2.0 * acceleration * distance + EPSILON


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_limits_that_make_no_sense_are_refused_by_name(value: float) -> None:
    with pytest.raises(ValueError, match="climb_mps must be a positive number"):
        Limits(climb_mps=value)
