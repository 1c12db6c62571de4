"""How long an answer is waited for."""

from __future__ import annotations

import pytest

from skyfolio.mavlink_bridge.round_trip import RoundTrip

QUICK_S, SLOW_S = 0.02, 1.5


def hung() -> RoundTrip:
    """A vehicle that was quick, hung for two seconds, and has answered one of 44 copies."""
    trip = RoundTrip()
    for began_s in range(8):
        trip.answered(began_s, began_s + QUICK_S, 1)
    trip.answered(8.0, 10.0, 44)
    assert trip.timeout_s > 2.0
    return trip


def test_a_vehicle_that_hung_is_soon_asked_again_as_quickly_as_before() -> None:
    trip = hung()
    for began_s in (11.0, 12.0, 13.0):
        assert trip.timeout_s > 2.0
        trip.answered(began_s, began_s + QUICK_S, 1)
    assert trip.timeout_s < 0.05
    assert trip.seconds == pytest.approx(QUICK_S)


def test_late_answers_to_earlier_copies_do_not_make_a_slow_link_look_quick() -> None:
    trip = hung()
    for began_s in (11.0, 12.0, 13.0, 14.0):
        trip.answered(began_s, began_s + 1e-6, 1)
    assert trip.timeout_s > 2.0


def test_a_link_that_has_become_slow_is_waited_for() -> None:
    trip = hung()
    for began_s in range(11, 51, 2):
        trip.answered(began_s, began_s + SLOW_S, 1)
        assert trip.timeout_s > SLOW_S


def test_a_few_copies_measure_nothing_where_something_better_is_known() -> None:
    trip = RoundTrip()
    trip.answered(0.0, QUICK_S, 1)
    trip.answered(1.0, 1.5, 3)
    assert trip.seconds == pytest.approx(QUICK_S)


def test_an_answer_to_a_copy_ends_a_wait_that_is_longer_than_it_took() -> None:
    trip = RoundTrip()
    for began_s in range(8):
        trip.answered(began_s, began_s + QUICK_S, 1)
    for _ in range(5):  # four requests in a row whose first copy is lost, and one that is lost twice
        trip.missed()
    backed_off_s = trip.timeout_s
    trip.answered(9.0, 9.0 + 1.5 * QUICK_S, 2)
    assert trip.timeout_s < backed_off_s / 2


def test_an_answer_that_took_so_long_at_most_is_not_waited_for_three_times_as_long() -> None:
    trip = RoundTrip()
    trip.answered(0.0, 4.0, 2)  # the first copy was sent while the link was dead
    assert 4.0 < trip.timeout_s <= 6.0
