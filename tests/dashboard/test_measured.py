"""Measured rates on the dashboard: it says which they are, and what base stations fail to acknowledge."""

from typing import Any

import pytest

from skyfolio.api.dashboard.event_text import describe
from skyfolio.api.dashboard.measured import measured_share, source_words
from skyfolio.api.dashboard.situation import achieved_line
from skyfolio.api.dashboard.views import ServiceEvent

RATES: dict[str, list[float | None]] = {"a": [1e3, 2e3, None], "b": [1e3, 1e3, None]}


def said(kind: str, **data: Any) -> tuple[str, str]:
    return describe(ServiceEvent(id=1, at="2026-01-01T00:00:00Z", kind=kind, data=data))


@pytest.mark.parametrize(
    ("slots", "words"),
    [
        ({}, "computed from positions"),
        ({"a": [0]}, "25% measured, the rest computed from positions"),
        ({"a": [0, 1], "b": [0, 1]}, "measured"),
    ],
)
def test_it_says_where_rates_come_from(slots: dict[str, list[int]], words: str) -> None:
    assert source_words(RATES, slots) == words
    assert (achieved_line(RATES, slots) or "").endswith(f"({words})")


def test_slots_that_are_not_known_do_not_count() -> None:
    assert measured_share(RATES, {"a": [0, 2, 7]}) == 0.25
    assert measured_share({}, {}) == 0.0


def test_allocations_are_told_only_where_a_base_station_is_behind() -> None:
    assert said("allocations", revision=4, unacknowledged=[]) == ("", "")
    text, level = said("allocations", revision=4, unacknowledged=["uav-2"])
    assert ("uav-2" in text, level) == (True, "warn")


def test_what_is_done_at_once_after_a_loss_is_told_and_so_is_that_it_cannot_be() -> None:
    assert said("reassociated", lost=["uav-3"], plan_id="p", error=None) == (
        "users of uav-3 are served by the others at once",
        "ok",
    )
    assert said("reassociated", lost=["uav-3"], plan_id=None, error="no worker")[1] == "alarm"
    assert said("reassociated", lost=["uav-3"], plan_id=None, error=None) == ("", "")
    assert "31% off" in said("rates_off", slot=3, difference=0.31)[0]
