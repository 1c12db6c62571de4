"""What a condition of a UAV means for the operation that it flies in."""

import pytest

from skyfolio.api.flights.losses import LOSS_KINDS, Loss, really, seen, silent
from skyfolio.mavlink_bridge import FlightMode
from skyfolio.mavlink_bridge.conditions import Change, Condition


def change(after: Condition) -> Change:
    return Change(system_id=1, before=Condition.LIVE, after=after, cause="seen so", at_s=7.0)


@pytest.mark.parametrize("flown", [True, False])
@pytest.mark.parametrize(
    "harmless", [None, *(change(one) for one in Condition if one.serves), change(Condition.LINK_LOST)]
)
def test_who_serves_counts_and_silence_is_judged_elsewhere(harmless: Change | None, flown: bool) -> None:
    assert seen(harmless, plan_is_flown=flown) is None


@pytest.mark.parametrize("condition", [Condition.CRASHED, Condition.HUMAN])
def test_a_crash_and_a_human_end_the_service_at_any_time(condition: Condition) -> None:
    assert seen(change(condition), plan_is_flown=False) == seen(change(condition), plan_is_flown=True)
    assert seen(change(condition), plan_is_flown=True) is not None


@pytest.mark.parametrize("condition", [Condition.LANDED, Condition.FAILSAFE])
def test_a_return_and_a_landing_are_losses_only_while_the_plan_is_flown(condition: Condition) -> None:
    assert seen(change(condition), plan_is_flown=False) is None
    loss = seen(change(condition), plan_is_flown=True)
    assert loss is not None
    assert (loss.detail, loss.silent_for_s, loss.may_return) == ("seen so", 0.0, False)


def test_only_who_was_silent_may_return_and_only_who_is_down_frees_its_air() -> None:
    every = {kind: Loss(kind, "") for kind in LOSS_KINDS}
    assert {kind for kind, loss in every.items() if loss.may_return} == {"heartbeat_lost"}
    assert {kind for kind, loss in every.items() if not loss.in_the_air} == {"crashed", "landed"}
    assert silent(5.25) == Loss("heartbeat_lost", "silent for 5.2 s", 5.25)


@pytest.mark.parametrize("mode", list(FlightMode))
def test_who_is_on_the_ground_in_the_middle_of_its_plan_has_landed_only_in_a_mode_that_lands(mode: FlightMode) -> None:
    fell = mode in {FlightMode.MISSION, FlightMode.OFFBOARD, FlightMode.GUIDED}
    loss = really(Loss("landed", "disarmed at 0.0 m"), mode)
    assert loss.kind == ("crashed" if fell else "landed")
    assert (f"in mode '{mode}'" in loss.detail) is fell
    silence = silent(5.0)
    assert really(silence, mode) is silence
