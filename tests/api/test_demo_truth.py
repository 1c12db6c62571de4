"""Rates of a demo's flight: those of its slots, and not of what base stations report while UAVs land."""

from __future__ import annotations

import numpy as np
import pytest

from skyfolio.api.lab.demo import truth
from skyfolio.planner import EXAMPLES


def test_what_is_measured_after_the_last_slot_or_before_the_first_is_in_no_mean() -> None:
    scenario = EXAMPLES["minimal"]()
    end_s = scenario.slots * scenario.slot_duration_s
    by_slot = np.full((len(scenario.users), scenario.slots), 1000.0)
    inside = np.linspace(0.0, end_s - 0.1, 50)
    at = np.concatenate([[-1.0], inside, end_s + np.arange(30.0)])
    sums = np.where((at >= 0.0) & (at < end_s), by_slot[:, 0].sum(), 0.0)
    rates = truth._rates(scenario, by_slot, at, sums, end_s / 2, end_s / 2 + 1.0)
    assert rates.mean_sum_rate_before_bps == pytest.approx(by_slot[:, 0].sum())
    assert rates.mean_sum_rate_after_bps == pytest.approx(by_slot[:, 0].sum())
