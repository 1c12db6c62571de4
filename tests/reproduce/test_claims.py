"""Verdicts follow from rules, and every claim that is not reproduced says what would settle it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyfolio.api.lab.reproduce.claims import STILL, rank_agreement
from skyfolio.api.lab.reproduce.courses import (
    BASELINE_1,
    BASELINE_2,
    FAILURE_SLOT,
    READINGS,
    SR_MAX,
    Choices,
    Job,
    Scheme,
    compute,
    fly,
)
from skyfolio.api.lab.reproduce.estimates import Estimate, Measured
from skyfolio.api.lab.reproduce.settling import otherwise, settling, statement
from skyfolio.api.lab.reproduce.verdicts import Judged, Verdict, compared, held

EXCLUDES = "which excludes this reading"
STUDY = Path(__file__).parents[2] / "docs/reproduction/study.json"


def estimate(value: float, half: float, spread: float = 0.0) -> Estimate:
    return Estimate(value, half, 0.0, np.array([[value - spread], [value + spread]]))


@pytest.mark.parametrize(
    ("value", "half", "spread", "verdict"),
    [
        (100.0, 1.0, 1.0, Verdict.REPRODUCED),  # 0 off
        (109.0, 1.0, 1.0, Verdict.REPRODUCED),  # within 10 %
        (109.0, 20.0, 1.0, Verdict.REPRODUCED),  # and the interval is no wider than 25 %
        (100.0, 30.0, 1.0, Verdict.OPEN),  # right by luck
        (120.0, 1.0, 40.0, Verdict.REPRODUCED),  # within 25 %, and an ordinary case
        (120.0, 1.0, 1.0, Verdict.TREND_ONLY),  # within 25 %, and the interval beyond 10 %
        (120.0, 12.0, 1.0, Verdict.OPEN),  # the interval reaches within 10 %
        (130.0, 1.0, 1.0, Verdict.NOT),
        (130.0, 1.0, 90.0, Verdict.NOT),  # spread makes nothing near
        (130.0, 6.0, 1.0, Verdict.OPEN),  # the interval reaches within 25 %
    ],
)
def test_a_number_is_judged_by_its_size_and_is_open_where_noise_would_decide(
    value: float, half: float, spread: float, verdict: Verdict
) -> None:
    found, _, settles = compared(estimate(value, half, spread), 100.0)
    assert found is verdict
    assert (" layouts: the" in settles) == (verdict is Verdict.OPEN)


@pytest.mark.parametrize(
    ("cases", "value", "half", "verdict"),
    [
        ([1.0] * 9 + [-1.0], 0.8, 0.1, Verdict.REPRODUCED),
        ([3.0, -1.0], 1.0, 0.5, Verdict.TREND_ONLY),
        ([3.0, -1.0], 1.0, 1.5, Verdict.OPEN),
        ([1.0] * 10, 1.0, 1.5, Verdict.OPEN),
        ([-1.0] * 9 + [1.0], -0.8, 0.1, Verdict.NOT),
        ([0.0] * 4, 0.0, 0.0, Verdict.NOT),  # nothing changes, and that is certain
    ],
)
def test_a_trend_must_hold_on_average_in_most_cases_and_beyond_noise(
    cases: list[float], value: float, half: float, verdict: Verdict
) -> None:
    found = Estimate(value, half, 0.0, np.array(cases)[:, None])
    assert held(found, found)[0] is verdict


def test_the_interval_of_a_mean_is_students_and_that_of_draws_sees_draws_alone() -> None:
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(5, 4, 1)) + 10 * np.arange(4)[None, :, None]  # (S, L, F)
    leaves = np.array([draws.mean(axis=0), *(np.delete(draws, out, axis=0).mean(axis=0) for out in range(5))])
    found = Measured({"a": {"x": leaves}}).estimate(lambda of: of("a", "x"))
    layouts = draws.mean(axis=(0, 2))
    assert found.value == pytest.approx(draws.mean())
    assert found.half == pytest.approx(3.182446 * layouts.std(ddof=1) / 2, rel=1e-5)
    assert found.draws_half == pytest.approx(2.776445 * draws.mean(axis=(1, 2)).std(ddof=1) / np.sqrt(5), rel=1e-5)


def test_a_ratio_is_one_of_means_and_not_a_mean_of_ratios() -> None:
    tables = {name: {"x": np.array([[row]]).transpose(0, 2, 1)} for name, row in (("a", [1.0, 3.0]), ("b", [1.0, 1.0]))}
    assert Measured(tables).estimate(lambda of: of("a", "x") / of("b", "x")).value == pytest.approx(2.0)
    assert Measured(tables).estimate(lambda of: of("b", "x") / of("a", "x")).value == pytest.approx(0.5)


def test_schemes_that_flew_on_fewer_layouts_are_compared_on_those_alone() -> None:
    tables = {"a": {"x": np.array([[[1.0], [1.0], [7.0]]])}, "b": {"x": np.array([[[1.0], [1.0]]])}}
    both = Measured(tables).estimate(lambda of: of("a", "x") - of("b", "x"))
    assert both.value == 0.0
    assert both.cases.shape == (2, 1)
    assert Measured(tables).estimate(lambda of: of("a", "x")).value == 3.0


def judged(claim: str, kind: str | None, reading: str | None, verdict: Verdict) -> Judged:
    return Judged(figure="3", claim=claim, kind=kind, reading=reading, ours=1.0, verdict=verdict, reason="")


def test_an_open_number_says_how_many_layouts_would_decide() -> None:
    assert "8 layouts: the interval would be narrow" in compared(estimate(100.0, 50.0), 100.0)[2]
    assert "16 layouts: the interval would clear the 25% line" in compared(estimate(130.0, 14.0), 100.0)[2]


def test_one_statement_of_the_letter_is_known_in_each_of_its_readings() -> None:
    placed, fixed = "Baseline 2 (placed)", "Baseline 2 (at the starts)"
    one = judged(f"sum, that variance over that of {placed}", "sum", placed, Verdict.NOT)
    other = judged(f"pooled, that variance over that of {fixed}", "pooled", fixed, Verdict.REPRODUCED)
    assert statement(one) == statement(other) == "that variance over that of Baseline 2"
    assert otherwise(one, [one, other]) == [f"`pooled` and {fixed}"]
    assert otherwise(one, [one, judged("sum, variance at mu = -10", "sum", None, Verdict.REPRODUCED)]) == []
    study: dict[str, Any] = {"calibration": None, "ablation": {}}
    assert settling(one, [one, other], study) == "met under `pooled` and Baseline 2 (at the starts), " + EXCLUDES


def test_a_reading_that_the_joint_fit_picks_is_not_excluded_by_those_that_it_excludes() -> None:
    picked, other = "Baseline 2 (for the mean channel)", "Baseline 2 (placed)"
    values = [{"value": "for the mean channel", "best_in": 1.0}, {"value": "placed", "best_in": 0.0}]
    study: dict[str, Any] = {"calibration": {"refined": {"told_apart": {"baseline_2": values}}}, "ablation": {}}
    one = judged(f"{picked} recovers after it", None, picked, Verdict.TREND_ONLY)
    two = judged(f"{other} recovers after it", None, other, Verdict.REPRODUCED)
    assert settling(one, [one, two], study) == f"met under {other}, which the joint fit excludes"
    one = one.model_copy(update={"verdict": Verdict.REPRODUCED})
    two = two.model_copy(update={"verdict": Verdict.OPEN})
    assert settling(two, [one, two], study) == (
        f"met under {picked}, {EXCLUDES}; the joint fit excludes this reading (best in 0% of resamples)"
    )


def test_the_letters_own_utility_meets_all_of_its_numbers_in_the_reading_that_the_fit_picks() -> None:
    study = json.loads(STUDY.read_text())
    picked = study["calibration"]["refined"]["best"]["setting"]["baseline_2"]
    numbers = [
        one["verdict"]
        for one in study["claims"]
        if one["paper"] and one["kind"] in (None, "sum") and one["reading"] in (None, f"Baseline 2 ({picked})")
    ]
    assert numbers == ["reproduced"] * 10


def test_per_user_steadies_users_and_not_their_sum() -> None:
    headline = json.loads(STUDY.read_text())["headline"]
    weak, strong = (headline[f"Pro-Alg per_user mu={mu}"] for mu in ("-0.01", "-0.1"))
    assert strong["variance"]["mean"] > weak["variance"]["mean"]
    assert strong["jain"]["mean"] > weak["jain"]["mean"]


def test_every_claim_of_the_document_that_is_not_reproduced_says_what_would_settle_it() -> None:
    study = json.loads(STUDY.read_text())
    claims = [Judged.model_validate(one) for one in study["claims"]]
    assert len(claims) == 25 + 10 * len(READINGS)
    assert len({statement(one) for one in claims}) == 25
    for one in claims:
        if one.verdict is Verdict.OPEN:
            assert " layouts: the" in settling(one, claims, study)
        elif one.verdict is Verdict.NOT:
            assert "nothing here can stand in for" not in settling(one, claims, study), one.claim


def test_a_placement_is_worth_nearly_what_trajectories_are() -> None:
    """Why SR-Max is not far above a Baseline 2 that is placed as well as it can be."""
    choices = [Choices(draws=2, layout_seed=seed) for seed in range(100, 104)]
    most, placed = (
        np.mean([compute(Job(each, one, (None,))).course(0).measures()["period_1"] for each in choices])
        for one in (SR_MAX, BASELINE_2)
    )
    assert placed < most < 1.1 * placed


@pytest.mark.parametrize("scheme", STILL)
def test_a_baseline_that_does_not_fly_cannot_recover(scheme: Scheme) -> None:
    choices = Choices(fading="mean", layout_seed=100)
    course = fly(choices.scenario(scheme.utility), scheme.method, "uav-2")
    assert np.ptp(course.sum_kbps[FAILURE_SLOT:]) == pytest.approx(0.0, abs=1e-9)


def test_rank_agreement_is_one_for_a_rise_and_nothing_for_a_constant() -> None:
    assert rank_agreement(np.array([1.0, 2.0, 5.0, 6.0])) == pytest.approx(1.0)
    assert rank_agreement(np.array([4.0, 3.0, 1.0])) == pytest.approx(-1.0)
    assert rank_agreement(np.full(5, 3.0)) == 0.0


def test_equal_shares_for_the_users_of_the_lost_uav_cost_sum_rate() -> None:
    """Why Baseline 1 regains none: its adjustment is for users and not for the sum."""
    for seed in range(100, 104):
        flown = compute(Job(Choices(fading="mean", layout_seed=seed), BASELINE_1))
        for lost in range(3):
            measures = flown.course(lost).measures()
            assert measures["period_2"] < measures["unadjusted"]
