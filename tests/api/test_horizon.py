"""How far ahead an operation is planned, and what is kept of it, without a flight."""

from __future__ import annotations

import pytest

from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.endless.horizon import Horizon, terms_in
from skyfolio.api.flights.endless.long_record import thinned
from skyfolio.api.flights.endless.terms import End, Terms, terms_of
from skyfolio.api.flights.flight_timeline import FlightTimeline
from skyfolio.api.flights.track import Track
from skyfolio.planner import EXAMPLES, Plan, plan

SLOT_S = 5.0
TERMS = Terms(horizon_slots=4, replan_every_slots=1, end=End(duration_s=500.0))


@pytest.fixture(scope="module")
def first() -> Plan:
    made = plan(EXAMPLES["minimal"]())
    assert made.scenario.slots == 4
    return made


class Seconds:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def clock(self) -> FleetClock:
        return FleetClock(seconds=lambda: self.now_s, utc=lambda: 1_000.0 + self.now_s)


def flown(first: Plan, terms: Terms = TERMS) -> tuple[Seconds, FlightTimeline, Horizon]:
    seconds = Seconds()
    clock = seconds.clock()
    timeline = FlightTimeline(first, clock)
    timeline.set_slot_clock(0.0)
    return seconds, timeline, Horizon(terms, timeline, clock)


def later(first: Plan, at_slot: int, name: str) -> Plan:
    return first.model_copy(update={"id": name, "first_slot": at_slot})


def test_an_extension_is_due_in_time_for_each_plan_to_be_flown_for_so_many_slots(first: Plan) -> None:
    seconds, timeline, horizon = flown(first)
    assert horizon.is_due(), "the next plan begins with slot 1, when three are left"
    assert horizon.slots_from(1) == 4
    timeline.take_over(later(first, 1, "second"))
    assert (timeline.n_slots, horizon.is_due()) == (5, False)
    seconds.now_s = SLOT_S
    assert horizon.is_due()


def test_each_further_try_asks_for_half_as_many_more_slots_and_never_for_less_than_is_planned(first: Plan) -> None:
    _, timeline, horizon = flown(first, Terms(horizon_slots=12, replan_every_slots=1))
    assert [horizon.slots_from(2, tried=tried) for tried in range(5)] == [12, 7, 4, 3, 2]
    timeline.take_over(later(first, 30, "longer"))
    assert horizon.slots_from(31) == 12


def test_nothing_is_due_once_the_end_is_planned_and_the_end_may_be_moved(first: Plan) -> None:
    seconds, timeline, horizon = flown(first, Terms(horizon_slots=4, replan_every_slots=1, end=End(duration_s=30.0)))
    assert (horizon.end_slot(), horizon.slots_from(3)) == (6, 3)
    timeline.take_over(later(first, 2, "last"))
    seconds.now_s = 4 * SLOT_S
    assert not horizon.is_due()
    horizon.move_end(End(until_utc_s=1_000.0 + 60.0))
    assert (horizon.end_slot(), horizon.is_due()) == (12, True)
    horizon.move_end(End())
    assert horizon.end_slot() is None


def test_a_time_of_day_comes_nearer_while_the_slot_clock_stands_still(first: Plan) -> None:
    seconds, timeline, horizon = flown(
        first, Terms(horizon_slots=4, replan_every_slots=1, end=End(until_utc_s=1_100.0))
    )
    assert horizon.end_slot() == 20
    timeline.set_slot_clock(0.0, paused=True)
    seconds.now_s = 50.0
    assert horizon.end_slot() == 10


def test_what_a_restart_needs_is_what_was_asked(first: Plan) -> None:
    _, _, horizon = flown(first)
    horizon.extensions = 7
    assert terms_in(horizon.document()) == (TERMS, 7)


def test_terms_have_defaults_and_rules(first: Plan) -> None:
    assert terms_of(first) == Terms(horizon_slots=4, replan_every_slots=1)
    with pytest.raises(InvalidError, match="replan_every_slots: 2 must be at most horizon_slots - 3, 1"):
        terms_of(first, replan_every_slots=2)
    with pytest.raises(InvalidError, match=r"duration_s: 10 must be at least that of the plan, 20"):
        terms_of(first, end=End(duration_s=10.0))


def test_plans_that_are_over_are_forgotten_except_for_the_first_one(first: Plan) -> None:
    _, timeline, _ = flown(first)
    for number in range(1, 6):
        timeline.take_over_since(10.0 * number, later(first, 2 * number, f"plan-{number}"))
    gone = timeline.forget_plans_before(35.0)
    assert [one.id for one in gone] == ["plan-1", "plan-2"]
    assert [entry.plan.id for entry in timeline.timeline] == [first.id, "plan-3", "plan-4", "plan-5"]
    assert [entry.plan.id for entry in timeline.serving] == [first.id, "plan-3", "plan-4", "plan-5"]
    assert timeline.forget_plans_before(35.0) == []
    assert timeline.last_slot_of("uav-1") == 2 * 5 + 3
    assert timeline.last_slot_of("nobody") == -1


def test_a_track_forgets_its_oldest_part_and_keeps_the_numbers_of_the_rest() -> None:
    track = Track(["a", "b"])
    for number in range(10):
        track.append(0.5 * number, {"a": (float(number), 0.0)})
    track.forget_before(2.0)
    assert (track.first, len(track), track.end) == (4, 6, 10)
    assert track.numbered(4) == track[0] == (2.0, {"a": (4.0, 0.0)})
    assert track.since(8) == track[-2:]
    assert track.since(0) == list(track)
    assert [at_s for at_s, _ in track.between(2.5, 4.0)] == [2.5, 3.0, 3.5]


def test_a_track_is_thinned_to_the_first_sample_of_each_five_seconds() -> None:
    samples = [(0.5 * number, {"a": (0.0, 0.0)}) for number in range(25)]
    assert [at_s for at_s, _ in thinned(samples)] == [0.0, 5.0, 10.0]
