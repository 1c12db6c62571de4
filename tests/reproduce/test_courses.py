"""Courses over several draws of the fading."""

from dataclasses import replace

import numpy as np
import pytest

from skyfolio.api.lab.reproduce.calibration import FIRST_LAYOUT as CALIBRATED_FROM
from skyfolio.api.lab.reproduce.calibration import FIRST_REFINED
from skyfolio.api.lab.reproduce.courses import (
    BASELINE_1,
    FAILED,
    FAILURE_SLOT,
    SR_MAX,
    STARTS,
    Choices,
    Course,
    Job,
    Scheme,
    compute,
    fly,
    pro_alg,
)
from skyfolio.api.lab.reproduce.study import StudyConfig, layouts

DRAWN = Choices(draws=3, layout_seed=100)


def test_rates_are_averaged_over_draws_before_the_variance_is_taken() -> None:
    flown = compute(Job(DRAWN, SR_MAX))
    assert flown.draws_kbps.shape == (3, len(FAILED), 9, 20)
    course = flown.course(1)
    assert course.rates_kbps == pytest.approx(flown.draws_kbps[:, 1].mean(axis=0))
    each = [Course(rates, 0.0).measures() for rates in flown.draws_kbps[:, 1]]
    assert course.measures()["variance"] < np.mean([one["variance"] for one in each])
    assert course.measures()["period_1"] == pytest.approx(np.mean([one["period_1"] for one in each]))
    assert flown.course(1, slice(1)).measures() == each[0]


def test_each_draw_is_a_plan_for_that_draw() -> None:
    flown = compute(Job(DRAWN, SR_MAX, ("uav-2",)))
    for draw in (0, 2):
        alone = fly(DRAWN.scenario(SR_MAX.utility, draw), "sr_max", "uav-2", n_starts=STARTS)
        assert flown.draws_kbps[draw, 0] == pytest.approx(alone.rates_kbps)


def test_mean_fading_has_one_draw_whatever_is_asked() -> None:
    flown = compute(Job(replace(DRAWN, fading="mean"), BASELINE_1, (None,)))
    assert flown.draws_kbps.shape == (1, 1, 9, 20)
    assert np.ptp(flown.course(0).sum_kbps) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("scheme", [SR_MAX, pro_alg("pooled", -0.3)], ids=lambda scheme: scheme.name)
def test_planners_that_know_statistics_alone_fly_one_plan_through_all_draws(scheme: Scheme) -> None:
    told = replace(DRAWN, knows="statistics")
    lost = compute(Job(told, scheme, ("uav-3",))).draws_kbps[:, 0]
    blind = fly(told.scenario(scheme.utility), scheme.method, "uav-3", n_starts=STARTS)
    served = blind.rates_kbps[:, :FAILURE_SLOT] > 0
    assert ((lost[:, :, :FAILURE_SLOT] > 0) == served).all(), "the same users are served in every draw"
    assert not np.isclose(lost[0], lost[1]).all(), "but they get what was drawn"


def test_knowing_the_draws_is_worth_something() -> None:
    known, guessed = (
        compute(Job(replace(DRAWN, knows=knows), SR_MAX, (None,))).course(0).measures()["mean"]
        for knows in ("draw", "statistics")
    )
    assert known > guessed * 1.05


def test_a_held_draw_is_the_same_in_every_slot() -> None:
    held = compute(Job(replace(DRAWN, fading="held"), BASELINE_1, (None,))).draws_kbps[:, 0].sum(axis=1)
    assert np.ptp(held, axis=1) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.ptp(held[:, 0]) > 0.1


def test_claims_are_judged_on_layouts_that_the_calibration_has_not_seen() -> None:
    seeds = [choices.layout_seed for choices in layouts(StudyConfig(layouts=20))]
    assert len(set(seeds)) == 20
    assert max(seeds) < CALIBRATED_FROM < FIRST_REFINED
