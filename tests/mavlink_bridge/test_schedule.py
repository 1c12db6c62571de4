from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.mavlink_bridge import VehicleModel
from skyfolio.mavlink_bridge.plane import segment_distances_m
from skyfolio.mavlink_bridge.schedule import SAME_PLACE_M, STRAIGHT_M, Schedule, airborne_schedule, ground_schedule

PX4 = VehicleModel()
coordinate = st.one_of(st.sampled_from([0.0, 10.0, 25.0]), st.floats(-300, 300))
paths = st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=30)
slot_durations = st.floats(0.5, 60)


@given(path=paths, slot_s=slot_durations)
def test_legs_and_holds_last_exactly_as_long_as_the_slots(path: list[tuple[float, float]], slot_s: float) -> None:
    assert ground_schedule(path, slot_s, PX4).duration_s == pytest.approx(len(path) * slot_s)


@given(path=paths, slot_s=slot_durations, first_s=st.floats(0.1, 60))
def test_in_flight_they_last_the_first_leg_and_the_slots_after_it(
    path: list[tuple[float, float]], slot_s: float, first_s: float
) -> None:
    schedule = airborne_schedule(path, slot_s, first_s, PX4)
    assert schedule.duration_s == pytest.approx(first_s + (len(path) - 1) * slot_s)
    assert all(stop.slot >= min(1, len(path) - 1) for stop in schedule.stops)


@given(path=paths, slot_s=slot_durations)
def test_every_slot_is_spent_at_its_stop_or_on_the_straight_way_to_the_next(
    path: list[tuple[float, float]], slot_s: float
) -> None:
    stops = ground_schedule(path, slot_s, PX4).stops
    assert stops[0].slot == 0
    for stop, following in pairwise(stops):
        for slot in range(stop.slot, following.slot):
            (on_the_way,) = segment_distances_m([(path[slot], path[slot])], [(stop.point_m, following.point_m)])
            assert on_the_way < SAME_PLACE_M + STRAIGHT_M


def test_hovering_slots_become_one_stop_with_a_hold() -> None:
    schedule = ground_schedule([(0, 0), (20, 0), (20.05, 0), (20, 0), (40, 0)], 5.0, PX4)
    assert [(stop.slot, stop.hold_s) for stop in schedule.stops] == [(0, 0.0), (1, 10.0), (4, 5.0)]


def test_a_slow_drift_is_flown_and_not_merged_away() -> None:
    path = [(0.09 * slot, 0.0) for slot in range(12)]
    stops = ground_schedule(path, 5.0, PX4).stops
    assert stops[-1].point_m[0] == pytest.approx(path[-1][0], abs=SAME_PLACE_M)
    assert len(stops) > 1


def test_a_leg_too_short_to_be_slow_is_flown_at_the_least_speed_and_waited_for() -> None:
    schedule = ground_schedule([(0, 0), (0.5, 0), (20, 0)], 5.0, PX4)
    assert schedule.legs[0].speed_mps == PX4.min_speed_mps
    assert schedule.stops[1].hold_s == pytest.approx(5.0 - 0.5 / 0.2)


def test_all_slots_hovering_is_one_stop() -> None:
    schedule: Schedule = ground_schedule([(5, 5)] * 20, 5.0, PX4)
    assert [(stop.slot, stop.hold_s) for stop in schedule.stops] == [(0, 100.0)]
    assert schedule.legs == ()


def test_hovering_in_flight_still_has_a_leg_to_the_first_stop() -> None:
    schedule = airborne_schedule([(5, 5)] * 4, 5.0, 2.0, PX4)
    assert [(stop.slot, stop.hold_s) for stop in schedule.stops] == [(1, 17.0)]
    assert schedule.leg_to(0) is not None


def test_no_speed_is_above_what_the_vehicle_flies() -> None:
    assert ground_schedule([(0, 0), (500, 0)], 5.0, PX4).legs[0].speed_mps == PX4.max_speed_mps
