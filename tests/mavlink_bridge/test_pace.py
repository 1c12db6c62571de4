from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import VehicleModel
from skyfolio.mavlink_bridge.pace import Pacer, acceptance_radii, cruise_speed

PX4 = VehicleModel()
Points = list[tuple[float, float]]


def speeds(points: Points, halts: list[bool] | None = None, *, in_flight: bool = False) -> list[float]:
    """Speeds for legs of 5 s each, resting only at both ends unless told otherwise."""
    if halts is None:
        halts = [False] * (len(points) - 1) + [True]
    return Pacer(points, halts, [5.0] * (len(points) - 1), in_flight=in_flight, model=PX4).speeds()


@given(distance=st.floats(0.1, 100), duration=st.floats(1, 60), entry=st.floats(-0.5, 1), leave=st.floats(0, 1))
def test_cruise_speed_covers_the_leg_in_time_where_any_speed_can(
    distance: float, duration: float, entry: float, leave: float
) -> None:
    slow = distance / duration
    v = cruise_speed(distance, duration, entry_mps=entry * slow, leave_mps=leave * slow, model=PX4)
    takes_s = distance / v + (v - entry * slow) ** 2 / (6.0 * v) + (v - leave * slow) ** 2 / (4.8 * v)
    # infeasible legs sit at the minimum of the time; nothing is faster there
    for another in (v * 0.99, v * 1.01):
        other_s = (
            distance / another
            + (another - entry * slow) ** 2 / (6 * another)
            + (another - leave * slow) ** 2 / (4.8 * another)
        )
        assert takes_s == pytest.approx(duration) or (takes_s > duration and other_s >= takes_s)


def test_a_leg_from_rest_gets_the_speed_worked_by_hand() -> None:
    # 20 m in 5 s from rest at 3 m/s2, left at its own speed: 5 = 20/v + v/6, so v = 15 - sqrt(105)
    v = 15 - 105**0.5
    assert cruise_speed(20, 5, entry_mps=0, leave_mps=v, model=PX4) == pytest.approx(v)


def test_equal_legs_straight_through_are_flown_at_distance_over_time() -> None:
    assert speeds([(0, 20.0 * n) for n in range(8)])[2:6] == pytest.approx([4.0] * 4, rel=0.01)


def test_starting_from_rest_costs_speed() -> None:
    assert speeds([(0, 20.0 * n) for n in range(8)])[0] > 4.5


def test_in_flight_the_first_leg_costs_less_than_from_rest() -> None:
    line = [(0.0, 20.0 * n) for n in range(4)]
    assert 4.0 < speeds(line, in_flight=True)[0] < speeds(line)[0]


def test_a_sharp_corner_costs_the_leg_before_and_the_leg_after_it() -> None:
    straight = speeds([(0, 0), (20, 0), (40, 0), (60, 0), (80, 0)])
    corner = speeds([(0, 0), (20, 0), (40, 0), (40, 20), (40, 40)])
    assert corner[1] > straight[1] + 0.1
    assert corner[2] > straight[2] + 0.1


def test_short_legs_get_small_acceptance_radii() -> None:
    assert acceptance_radii([(0, 0), (20, 0), (21.5, 0), (21.8, 0)], PX4) == pytest.approx([1.0, 0.5, 0.2, 0.2])


def test_points_on_top_of_each_other_do_no_harm() -> None:
    assert all(v >= 0 for v in speeds([(0, 0), (0, 0), (20, 0)], in_flight=True))


@pytest.mark.parametrize(
    "field", ["acceleration_mps2", "braking_mps2", "max_speed_mps", "min_speed_mps", "acceptance_radius_m"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_the_vehicle_model_names_the_field_that_is_wrong(field: str, value: float) -> None:
    changed: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=field):
        replace(VehicleModel(), **changed)
