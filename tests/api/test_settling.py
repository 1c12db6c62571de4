"""What a service that is started again says of a recovery that the one before it has closed, or not."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.restart import _outcome_of_each


def entry(step: Step, **data: Any) -> Entry:
    at = datetime(2026, 1, 1, tzinfo=UTC)
    return Entry(operation_id="operation-1", incident=1, step=step, uav_id=None, at=at, elapsed_s=20.0, data=data)


TOLD = {"uav-1": None, "uav-2": "a later order overtook it"}


def test_a_recovery_that_was_closed_ended_for_each_uav_as_its_journal_says() -> None:
    entries = [entry(Step.DETECTED), entry(Step.FLYING, vehicles=TOLD), entry(Step.CLOSED, outcome="flying")]
    assert _outcome_of_each(entries) == TOLD


def test_a_recovery_that_was_not_closed_or_never_flown_is_looked_at_anew() -> None:
    assert _outcome_of_each([entry(Step.DETECTED), entry(Step.FLYING, vehicles=TOLD)]) is None
    assert _outcome_of_each([entry(Step.DETECTED), entry(Step.CLOSED, outcome="refused")]) is None
