"""What users are measured to get, over HTTP: kept, told apart from what is computed, and used in plans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from skyfolio.api.flights.rates_watch import PAUSE_SLOTS, RatesWatch, difference
from skyfolio.planner import EXAMPLES, Plan, Utility
from tests.api.sky import Sky, flight

FLEET = EXAMPLES["paper"]().with_changes(altitude_m=10.0, slots=10, utility=Utility(kind="pooled", mu_per_kbps=-0.1))


@pytest.fixture
def sky() -> Iterator[Sky]:
    with flight(FLEET, plan_ahead=False) as made:
        yield made


def post(sky: Sky, operation_id: str, *measurements: dict[str, Any]) -> Any:
    return sky.http.post(f"/v1/operations/{operation_id}/measurements", json={"measurements": list(measurements)})


def one(**fields: Any) -> dict[str, Any]:
    return {"uav_id": "uav-1", "user_id": "user-1", "elapsed_s": 1.0, "rate_bps": 4000.0, **fields}


def slot_is(sky: Sky, operation_id: str, slot: int) -> None:
    sky.until(operation_id, lambda view: view.slot == slot)


def of_everybody(sky: Sky, operation_id: str, slot: int, share: float) -> list[dict[str, Any]]:
    """Every user was measured to get this share of what the plan in force gave it in a slot that is over."""
    view = sky.client.operation(operation_id)
    plan = sky.client.read_plan(view.plan_id)
    assert isinstance(plan, Plan)
    n = max(slot - plan.first_slot, 0)
    return [
        one(
            uav_id=plan.association[user][n],
            user_id=user,
            elapsed_s=5.0 * slot + 4.5,
            rate_bps=share * (row[slot] or 0.0),
        )
        for user, row in view.user_rates_bps.items()
    ]


def test_measured_rates_take_the_place_of_computed_ones_and_are_told_apart(sky: Sky) -> None:
    operation_id = sky.take_off()
    sky.until(operation_id, lambda view: view.slot == 2)
    assert post(sky, operation_id, one(elapsed_s=6.0), one(elapsed_s=7.0, rate_bps=2000.0)).json() == {"new": 2}
    view = sky.client.operation(operation_id)
    assert view.measured_slots == {"user-1": [1]}
    assert view.user_rates_bps["user-1"][1] == pytest.approx(3000.0)
    computed = (view.user_rates_bps["user-1"][0], view.user_rates_bps["user-2"][1])
    assert all(rate is not None and rate > 5000.0 for rate in computed)
    ended = sky.ended(operation_id)
    assert ended.measured_slots == {"user-1": [1]}
    assert ended.user_rates_bps["user-1"][1] == pytest.approx(3000.0)


def test_a_measurement_that_is_sent_again_counts_once_also_after_a_restart(sky: Sky) -> None:
    operation_id = sky.take_off()
    sky.let_pass(3.0)
    assert post(sky, operation_id, one()).json() == {"new": 1}
    assert post(sky, operation_id, one(), one(user_id="user-2")).json() == {"new": 1}
    sky.stop()
    sky.start()
    assert post(sky, operation_id, one(), one(user_id="user-2")).json() == {"new": 0}
    assert sky.client.operation(operation_id).measured_slots == {"user-1": [0], "user-2": [0]}


def test_a_sinr_alone_says_what_rate_its_band_carries(sky: Sky) -> None:
    operation_id = sky.take_off()
    sky.let_pass(3.0)
    hertz = sky.plan.bandwidth_hz["user-1"][0]
    assert post(sky, operation_id, one(rate_bps=None, sinr_db=0.0)).status_code == 200
    assert sky.client.operation(operation_id).user_rates_bps["user-1"][0] == pytest.approx(hertz)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"user_id": "user-99"}, "measurements.0.user_id: 'user-99' is not a user"),
        ({"uav_id": "uav-99"}, "measurements.0.uav_id: 'uav-99' is not a UAV"),
        ({"elapsed_s": 900.0}, "measurements.0.elapsed_s: 900 is in the future"),
        ({"rate_bps": None}, "rate_bps, sinr_db"),
        ({"rate_bps": -1.0}, "rate_bps"),
        ({"quality": 5}, "quality"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_of_the_batch_is_taken(
    sky: Sky, wrong: dict[str, Any], said: str
) -> None:
    operation_id = sky.take_off()
    sky.let_pass(3.0)
    refused = post(sky, operation_id, one(**wrong), one(user_id="user-3"))
    assert refused.status_code == 422
    assert said in refused.text
    assert sky.client.operation(operation_id).measured_slots == {}


def test_rates_far_off_those_of_the_plan_correct_the_channel_and_lead_to_few_new_plans(sky: Sky) -> None:
    operation_id = sky.take_off()
    for slot in range(1, 6):  # whatever is planned, half of it arrives: no plan mends that
        slot_is(sky, operation_id, slot)
        assert post(sky, operation_id, *of_everybody(sky, operation_id, slot - 1, 0.5)).status_code == 200
    view = sky.client.operation(operation_id)
    assert {(report.cause, report.outcome) for report in view.recoveries} == {("rates_off", "flying")}
    assert len(view.recoveries) <= 2
    again = sky.client.read_plan(str(view.recoveries[0].plan_id))
    assert isinstance(again, Plan)
    assert again.cause.kind == "rates_off"
    assert "50% off those of the plan" in again.cause.detail
    corrections = again.scenario.channel.corrections_db
    assert corrections
    assert min(db for row in corrections.values() for db in row.values()) < -3.0


def test_an_operator_who_approves_plans_is_asked_about_this_one_too(sky: Sky) -> None:
    operation_id = sky.take_off(replanning="approve")
    for slot in (1, 2):
        slot_is(sky, operation_id, slot)
        assert post(sky, operation_id, *of_everybody(sky, operation_id, slot - 1, 0.5)).status_code == 200
    view = sky.until(operation_id, lambda view: view.proposal)
    assert view.plan_ids == [sky.plan.id]


def test_small_differences_change_no_plan(sky: Sky) -> None:
    operation_id = sky.take_off()
    for slot in range(1, 6):
        slot_is(sky, operation_id, slot)
        assert post(sky, operation_id, *of_everybody(sky, operation_id, slot - 1, 0.93)).status_code == 200
    assert sky.client.operation(operation_id).recoveries == []


# -- the watch, by itself ---------------------------------------------------------------------------------------------


def test_after_one_replan_there_is_another_once_it_was_better_meanwhile_or_after_a_pause() -> None:
    watch = RatesWatch(0.25)
    assert [watch.is_off(slot, off) for slot, off in enumerate([0.1, 0.3, 0.3, 0.3, 0.2, 0.3])] == [
        *(False, True, False, True, False, False)
    ]
    assert [watch.is_off(slot, off) for slot, off in ((10, 0.1), (11, 0.3))] == [False, True]


def test_a_difference_that_no_plan_mends_leads_to_ever_fewer_plans() -> None:
    watch = RatesWatch(0.25)
    slots = [slot for slot in range(100) if watch.is_off(slot, 0.9)]
    assert slots == [0, *((2**n - 1) * PAUSE_SLOTS for n in range(1, 6))]


def test_it_may_be_switched_off_and_knows_what_it_does_not_know() -> None:
    assert not RatesWatch(0.0).is_off(1, 9.0)
    assert not RatesWatch(0.25).is_off(1, None)


def test_the_difference_counts_users_that_were_measured_if_they_are_enough() -> None:
    promised: dict[str, list[float | None]] = {"a": [100.0, 200.0], "b": [100.0, 0.0], "c": [0.0, None]}

    def of(share: float, users: str) -> Any:
        return lambda user, slot: share * (promised[user][slot] or 0.0) if user in users else None

    assert difference(promised, of(0.6, "abc"), range(2)) == pytest.approx(0.4)
    assert difference(promised, of(1.5, "a"), range(2)) == pytest.approx(0.5)
    assert difference(promised, of(0.6, "b"), range(2)) is None
    assert difference(promised, of(0.6, "c"), range(2)) is None
    assert difference({"a": [0.0]}, lambda _user, _slot: 5.0, [0]) is None
