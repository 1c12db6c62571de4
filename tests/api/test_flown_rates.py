"""Rates kept while a flight goes on: the same as a whole recomputation, for work that grows with new samples only."""

import asyncio
from collections.abc import Mapping, Sequence
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.own_link import OwnLink
from skyfolio.api.flights import flown_rates
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.flown_rates import FlownRates
from skyfolio.api.flights.rates import InForce, Sample, rates_by_sample, rates_by_slot
from skyfolio.api.flights.track import Track
from skyfolio.planner import EXAMPLES, Plan, plan, replan

SLOT_S, N_SLOTS = 5.0, 4
UAVS = ("uav-1", "uav-2")
Where = dict[str, tuple[float, float]]
Lost = dict[str, float]
Row = Sequence[float | None]


@pytest.fixture(scope="module")
def first() -> Plan:
    return plan(EXAMPLES["minimal"]())


@pytest.fixture(scope="module")
def second(first: Plan) -> Plan:
    return replan(first, failed=["uav-2"], at_slot=2)


def in_one_go(timeline: Sequence[InForce], record: Sequence[tuple[float, Where]], lost: Lost) -> np.ndarray:
    """All rates from all samples, (K, N_SLOTS) bit/s, as if nothing were known yet."""
    samples = [
        Sample(at, where, frozenset(uav for uav in where if at <= lost.get(uav, inf)))
        for at, where in record
        if at < N_SLOTS * SLOT_S
    ]
    if not samples:
        return np.full((len(timeline[0].plan.scenario.users), N_SLOTS), np.nan)
    return rates_by_slot(timeline, samples, N_SLOTS)


def kept(by_user: Mapping[str, Row]) -> np.ndarray:
    return np.array([[np.nan if rate is None else rate for rate in row] for row in by_user.values()])


def of(track: Track, made: Plan) -> FlownRates:
    return FlownRates(track, made.scenario.user_ids, N_SLOTS, SLOT_S)


def track_of(record: Sequence[tuple[float, Where]] = ()) -> Track:
    made = Track(UAVS)
    for at, where in record:
        made.append(at, where)
    return made


def settle(rates: FlownRates, timeline: Sequence[InForce], lost: Lost) -> None:
    while rates.is_behind(timeline, lost):
        rates.work(timeline, lost, 3)


def places() -> st.SearchStrategy[Where]:
    here = st.tuples(st.floats(0.0, 400.0), st.floats(0.0, 400.0))
    return st.fixed_dictionaries({"uav-1": here}, optional={"uav-2": here})


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("sample"), st.floats(0.0, 2.5), places()),
        st.tuples(st.just("lose"), st.sampled_from(UAVS), st.floats(0.0, 6.0)),
        st.tuples(st.just("readmit"), st.sampled_from(UAVS), st.just(0.0)),
        st.tuples(st.just("take over"), st.floats(0.0, 6.0), st.just(0.0)),
        st.tuples(st.just("work"), st.integers(1, 4), st.just(0.0)),
    ),
    max_size=25,
)


@settings(max_examples=150, deadline=None)
@given(steps=STEPS)
def test_whatever_is_learned_when_the_rates_are_those_of_a_whole_recomputation(
    first: Plan, second: Plan, steps: list[tuple[str, object, object]]
) -> None:
    track, timeline, lost, now = track_of(), [InForce(0.0, first)], Lost(), 0.0
    rates = of(track, first)
    for what, one, other in steps:
        if what == "sample":
            now += float(one)  # type: ignore[arg-type]
            track.append(now, other)  # type: ignore[arg-type]
        elif what == "lose":
            lost.setdefault(str(one), now - float(other))  # type: ignore[arg-type]  # silent for a while already
        elif what == "readmit":
            lost.pop(str(one), None)
        elif what == "take over" and len(timeline) == 1:
            timeline.append(InForce(max(now - float(one), 0.0), second))  # type: ignore[arg-type]
        elif what == "work":
            rates.work(timeline, lost, int(one))  # type: ignore[call-overload]
    settle(rates, timeline, lost)
    np.testing.assert_allclose(kept(rates.by_user), in_one_go(timeline, track, lost), rtol=1e-12, atol=1e-9)


class Counted:
    """Stands where samples are evaluated, and counts them."""

    def __init__(self) -> None:
        self.samples, self.most = 0, 0

    def __call__(self, timeline: Sequence[InForce], samples: Sequence[Sample]) -> np.ndarray:
        self.samples += len(samples)
        self.most = max(self.most, len(samples))
        return rates_by_sample(timeline, samples)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    one = Counted()
    monkeypatch.setattr(flown_rates, "rates_by_sample", one)
    return one


def on_schedule(made: Plan, at_s: float) -> Where:
    return {uav: path[int(at_s // SLOT_S)] for uav, path in made.trajectories_m.items()}


def flown(made: Plan, until_s: float) -> list[tuple[float, Where]]:
    return [(at, on_schedule(made, at)) for at in np.arange(0.0, until_s, 0.5).tolist()]


def test_each_sample_is_evaluated_once_however_often_somebody_asks(first: Plan, counted: Counted) -> None:
    track, timeline = track_of(), [InForce(0.0, first)]
    rates = of(track, first)
    for number, (at, where) in enumerate(flown(first, 20.0), start=1):
        track.append(at, where)
        for _ in range(5):
            settle(rates, timeline, {})
            assert rates.by_user["user-1"][int(at // SLOT_S)] is not None
        assert counted.samples == number


def test_a_loss_declared_late_costs_the_slots_it_touches_and_no_more(first: Plan, counted: Counted) -> None:
    timeline, record = [InForce(0.0, first)], flown(first, 18.0)
    rates = of(track_of(record), first)
    settle(rates, timeline, {})
    assert counted.samples == len(record) == 36
    settle(rates, timeline, {"uav-2": 14.0})  # in the third slot, of ten samples; the fourth has six yet
    assert counted.samples == 36 + 16
    np.testing.assert_allclose(kept(rates.by_user), in_one_go(timeline, record, {"uav-2": 14.0}), rtol=1e-12)


def test_a_slot_that_is_summed_anew_keeps_its_rates_until_the_new_sum_is_whole(first: Plan) -> None:
    rates, timeline = of(track_of(flown(first, 5.0)), first), [InForce(0.0, first)]
    settle(rates, timeline, {})
    before = kept(rates.by_user)[:, 0]
    lost = {"uav-2": -1.0}
    rates.work(timeline, lost, 9)
    assert (kept(rates.by_user)[:, 0] == before).all()
    rates.work(timeline, lost, 1)
    assert (kept(rates.by_user)[:, 0] != before).any()


class Nobody:
    """A fleet whose vehicles are never heard."""

    link = None

    def own_link(self) -> OwnLink:
        return OwnLink(stale_after_s=3.0, lost_after_s=5.0)


def test_a_recalled_record_gives_the_same_rates_in_pieces_that_let_others_take_turns(
    first: Plan, counted: Counted
) -> None:
    def again() -> Flight:
        return Flight(first, {"uav-1": 1, "uav-2": 2}, Nobody(), FleetClock(1.0))  # type: ignore[arg-type]

    record = flown(first, 20.0)
    flight = again()
    flight.restore(record)
    assert counted.samples == 0
    assert set(flight.reported_rates_bps()["user-1"]) == {None}
    turns = 0

    async def restart() -> None:
        nonlocal turns

        async def other() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        task = asyncio.create_task(other())
        await flight.settle_rates()
        task.cancel()

    asyncio.run(restart())
    assert counted.samples == len(record) == 40
    assert counted.most <= 8
    assert turns >= 5
    found = kept(flight.reported_rates_bps())
    np.testing.assert_allclose(found, in_one_go([InForce(0.0, first)], record, {}), rtol=1e-12)
