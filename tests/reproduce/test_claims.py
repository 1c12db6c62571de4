"""Verdicts follow from rules."""

import numpy as np
import pytest

from skyfolio.api.lab.reproduce.claims import Verdict, _number, _trend, rank_agreement


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ([99.0, 101.0], Verdict.REPRODUCED),  # 0 off
        ([109.0, 109.0], Verdict.REPRODUCED),  # within 10 %
        ([80.0, 160.0], Verdict.REPRODUCED),  # within 25 % and one spread
        ([120.0, 120.0], Verdict.TREND_ONLY),  # within 25 %
        ([80.0, 240.0], Verdict.TREND_ONLY),  # within one spread, but far
        ([130.0, 130.0], Verdict.NOT),
    ],
)
def test_a_number_is_judged_by_its_distance_and_spread(values: list[float], verdict: Verdict) -> None:
    assert _number("3", "what", "kbit/s", 100.0, np.array(values)).verdict is verdict


@pytest.mark.parametrize(
    ("holds", "on_mean", "verdict"),
    [
        ([True] * 9 + [False], True, Verdict.REPRODUCED),
        ([True, False], True, Verdict.TREND_ONLY),
        ([True] * 10, False, Verdict.NOT),
    ],
)
def test_a_trend_must_hold_on_average_and_in_most_cases(holds: list[bool], on_mean: bool, verdict: Verdict) -> None:
    judged = _trend("5a", "falls", np.array(holds), on_mean)
    assert judged.verdict is verdict
    assert judged.ours == pytest.approx(np.mean(holds))


def test_rank_agreement_is_one_for_a_rise_and_nothing_for_a_constant() -> None:
    assert rank_agreement(np.array([1.0, 2.0, 5.0, 6.0])) == pytest.approx(1.0)
    assert rank_agreement(np.array([4.0, 3.0, 1.0])) == pytest.approx(-1.0)
    assert rank_agreement(np.full(5, 3.0)) == 0.0
