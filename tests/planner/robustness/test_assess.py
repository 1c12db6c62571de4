"""A plan under draws and losses: what is counted, what is named, and what ends it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from skyfolio.planner import (
    EXAMPLES,
    Disturbances,
    Losses,
    Plan,
    Robustness,
    RobustnessError,
    Trial,
    assess,
    plan,
    replan,
)

FEW = Disturbances(draws=30)
NONE = Losses(at_once=0)
UNDISTURBED = Disturbances(draws=3, fading=False, wind_mps=0.0, gust_mps=0.0, position_noise_m=0.0)


def assessed(made: Plan, stop: Callable[[], bool] = lambda: False, **asked: Any) -> Robustness:
    return assess(made, Trial(**asked), stop=stop)


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(EXAMPLES["paper"](), n_starts=4)


@pytest.fixture(scope="module")
def found(made: Plan) -> Robustness:
    return assessed(made, disturbances=FEW)


def table(made: Plan) -> np.ndarray:
    return np.array([made.user_rates_bps[user] for user in made.scenario.user_ids])


def test_without_disturbances_every_draw_is_the_plan(made: Plan) -> None:
    found = assessed(made, disturbances=UNDISTURBED, losses=NONE)
    assert found.planned_sum_rate_bps == pytest.approx(made.summary.mean_sum_rate_bps)
    assert found.sum_rate_bps.least_bps == pytest.approx(made.summary.mean_sum_rate_bps)
    assert found.sum_rate_bps.p95_bps == pytest.approx(made.summary.mean_sum_rate_bps)
    assert found.outage_probability == 0.0
    assert [user.rate_bps.p5_bps for user in found.users] == pytest.approx(table(made).mean(axis=1).tolist())


def test_the_same_seed_gives_the_same_answer_and_another_seed_another(made: Plan, found: Robustness) -> None:
    assert assessed(made, disturbances=FEW) == found
    assert assessed(made, disturbances=FEW.model_copy(update={"seed": 1})).sum_rate_bps != found.sum_rate_bps


def test_percentiles_are_in_order_and_outages_are_shares(found: Robustness) -> None:
    for row in (found.sum_rate_bps, *(user.rate_bps for user in found.users), *(one.rate_bps for one in found.losses)):
        assert row.least_bps <= row.p5_bps <= row.p50_bps <= row.p95_bps
    for share in (found.outage_probability, *(user.outage_probability for user in found.users)):
        assert share is None or 0.0 <= share <= 1.0
    assert found.outage_probability is not None
    assert found.outage_probability > 0.0


def test_a_user_that_the_plan_never_serves_has_no_outage(made: Plan, found: Robustness) -> None:
    never = {user for user, row in made.user_rates_bps.items() if max(row) == 0.0}
    assert {user.user_id for user in found.users if user.outage_probability is None} == never


def test_every_single_and_double_loss_is_tried(made: Plan, found: Robustness) -> None:
    assert [one.lost for one in found.losses] == [
        ("uav-1",),
        ("uav-2",),
        ("uav-3",),
        ("uav-1", "uav-2"),
        ("uav-1", "uav-3"),
        ("uav-2", "uav-3"),
    ]
    assert {(one.at_slot, one.replanned_from_slot, one.status) for one in found.losses} == {(10, 12, "replanned")}
    assert all(one.with_replan_bps >= 0.98 * one.without_replan_bps for one in found.losses)
    assert found.complete
    assert found.notes == ()
    assert made.scenario.uav_ids == ("uav-1", "uav-2", "uav-3")


def test_after_a_loss_the_rates_are_those_of_the_gap_and_then_of_the_replan(made: Plan) -> None:
    losses = Losses(at_once=1, at_slots=(8,), recovery_s=0.0, starts=2)
    (_, second, _) = assessed(made, disturbances=UNDISTURBED, losses=losses).losses
    new = replan(made, failed=["uav-2"], at_slot=8, n_starts=2)
    assert second.with_replan_bps == pytest.approx(table(new).sum(axis=0).mean())
    assert second.rate_bps.p50_bps == pytest.approx(second.with_replan_bps)
    assert second.planned_bps == pytest.approx(table(made)[:, 8:].sum(axis=0).mean())


def test_the_worst_cases_are_named(found: Robustness) -> None:
    single, double = found.worst.single_loss, found.worst.double_loss
    assert single is not None
    assert double is not None
    assert len(found.losses[single].lost) == 1
    assert len(found.losses[double].lost) == 2
    outages = [one.outage_probability or 0.0 for one in found.losses]
    assert outages[single] == max(outages[:3])
    assert outages[double] == max(outages[3:])
    worst_user = max(found.users, key=lambda user: user.outage_probability or 0.0)
    assert found.worst.user_id == worst_user.user_id
    assert 0 <= found.worst.draw < FEW.draws
    for user in found.users:
        assert user.worst_loss is not None


def test_users_that_only_a_lost_uav_could_serve_are_cut_off() -> None:
    made = plan(EXAMPLES["minimal"]().with_changes(slots=8), n_starts=4)
    found = assessed(made, disturbances=UNDISTURBED, losses=Losses(at_slots=(2,), recovery_s=5.0))
    both = found.losses[-1]
    assert both.lost == ("uav-1", "uav-2")
    assert both.status == "not_replanned"
    assert "no UAV would be left" in both.detail
    served = {user for user, row in made.user_rates_bps.items() if max(row[2:]) > 0.0}
    assert set(both.cut_off) == served
    assert both.with_replan_bps == 0.0
    assert both.outage_probability == 1.0


def test_a_loss_too_near_the_end_has_no_replan(made: Plan) -> None:
    (last, *_) = assessed(made, disturbances=UNDISTURBED, losses=Losses(at_once=1, at_slots=(19,))).losses
    assert (last.status, last.replanned_from_slot) == ("not_replanned", None)
    assert "ends before" in last.detail
    assert last.with_replan_bps == last.without_replan_bps


def test_minimum_rates_are_the_thresholds_of_users_that_have_one() -> None:
    easy = EXAMPLES["minimal"]()
    users = (easy.users[0].model_copy(update={"min_rate_bps": 1.0}), *easy.users[1:])
    made = plan(easy.with_changes(users=users), n_starts=4)
    first = assessed(made, disturbances=FEW, losses=NONE).users[0]
    assert first.outage_probability == 0.0, "half of what is planned would often be missed; 1 bit/s never is"


def test_an_absolute_threshold_counts_in_every_slot(made: Plan) -> None:
    found = assessed(made, disturbances=UNDISTURBED, losses=NONE, outage_bps=1.0)
    for user, row in zip(found.users, table(made), strict=True):
        assert user.outage_probability == pytest.approx((row < 1.0).mean())


def test_a_replan_is_assessed_on_the_slots_that_are_left(made: Plan) -> None:
    second = replan(made, failed=["uav-1"], at_slot=6, n_starts=2)
    found = assessed(second, disturbances=FEW, losses=Losses(at_once=1, at_slots=(12,)))
    assert [one.at_slot for one in found.losses] == [12, 12]
    assert found.losses[0].replanned_from_slot == 14
    with pytest.raises(RobustnessError, match=r"at_slots: 3 must lie in 6\.\.19"):
        assessed(second, losses=Losses(at_slots=(3,)))


@pytest.mark.parametrize("polls", [1, 5, 31, 33, 60])
def test_when_time_is_up_it_says_what_is_left_out(made: Plan, polls: int) -> None:
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > polls

    found = assessed(made, disturbances=FEW, stop=stop)
    assert not found.complete
    assert any("time was up" in note for note in found.notes)
    assert found.draws == min(FEW.draws, polls + 1)
    assert len(found.losses) < 6
    assert found.worst.draw < found.draws


def test_more_losses_than_are_allowed_are_left_out_and_counted(made: Plan) -> None:
    found = assessed(made, disturbances=UNDISTURBED, losses=Losses(most=4))
    assert len(found.losses) == 4
    assert found.notes == ("6 losses are more than 4: the first 4 were tried, single ones first",)


@pytest.mark.parametrize("wrong", [{"outage_share": 0.0}, {"outage_bps": 0.0}, {"losses": {"at_once": 3}}, {"draw": 1}])
def test_values_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        Trial.model_validate(wrong)


def test_a_loss_outside_the_plan_is_refused(made: Plan) -> None:
    with pytest.raises(RobustnessError, match=r"losses\.at_slots: 20 must lie in 0\.\.19"):
        assessed(made, losses=Losses(at_slots=(20,)))


def test_more_than_can_be_computed_is_refused_with_what_can(made: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyfolio.planner.robustness.trial.MOST_CELL_DRAWS", 540 * 10)
    with pytest.raises(RobustnessError, match=r"draws: 11 draws of 540 cells .* at most 10"):
        assessed(made, disturbances=Disturbances(draws=11))
