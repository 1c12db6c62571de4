"""Courses over several draws of the fading."""

from dataclasses import replace

import numpy as np
import pytest

from skyfolio.api.lab.reproduce.calibration import FIRST_LAYOUT as CALIBRATED_FROM
from skyfolio.api.lab.reproduce.calibration import FIRST_REFINED
from skyfolio.api.lab.reproduce.courses import (
    BASELINE_1,
    BASELINE_2,
    BASELINE_2_FIXED,
    BASELINE_2_ONCE,
    FAILED,
    FAILURE_SLOT,
    SR_MAX,
    STARTS,
    Choices,
    Course,
    Job,
    Scheme,
    Split,
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
    alone = flown.course(1, slice(1)).measures()
    assert {key: alone[key] for key in each[0] if key != "unadjusted"} == {
        key: value for key, value in each[0].items() if key != "unadjusted"
    }


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


def test_knowing_the_draws_is_worth_more_than_knowing_how_they_are_distributed() -> None:
    known, averaged, guessed = (
        compute(Job(replace(DRAWN, knows=knows), SR_MAX, (None,))).course(0).measures()["mean"]
        for knows in ("draw", "expectation", "statistics")
    )
    assert known > max(averaged, guessed) * 1.05


def test_one_reading_of_baseline_2_decides_once_whatever_the_others_know() -> None:
    once = compute(Job(DRAWN, BASELINE_2_ONCE, (None,))).draws_kbps[:, 0]
    told = compute(Job(replace(DRAWN, knows="statistics"), BASELINE_2, (None,))).draws_kbps[:, 0]
    assert once == pytest.approx(told)
    assert ((once > 0) == (once[0] > 0)).all(), "the same users are served in every draw"


def test_users_are_split_among_the_starts_as_said_and_in_another_order_in_another_layout() -> None:
    uneven = [replace(DRAWN, split="4, 3, 2", layout_seed=seed).users_per_uav() for seed in range(20)]
    assert {tuple(sorted(one)) for one in uneven} == {(2, 3, 4)}
    assert len(set(uneven)) == 6
    drawn = [replace(DRAWN, split="drawn", layout_seed=seed).users_per_uav() for seed in range(20)]
    assert {sum(one) for one in drawn} == {9}
    assert len(set(drawn)) > 6


@pytest.mark.parametrize("split", ["3, 3, 3", "4, 3, 2", "drawn"])
def test_each_user_is_within_the_radius_of_the_start_that_it_was_given(split: Split) -> None:
    choices = replace(DRAWN, split=split, user_radius_m=40.0)
    scenario = choices.scenario(SR_MAX.utility)
    starts = np.array([uav.start_m for uav in scenario.uavs])
    users = np.array([user.position_m for user in scenario.users])
    apart = np.linalg.norm(users[:, None] - starts, axis=2)
    assert tuple((apart <= 40.1).sum(axis=0)) == choices.users_per_uav()


def test_a_held_draw_is_the_same_in_every_slot() -> None:
    held = compute(Job(replace(DRAWN, fading="held"), BASELINE_1, (None,))).draws_kbps[:, 0].sum(axis=1)
    assert np.ptp(held, axis=1) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.ptp(held[:, 0]) > 0.1


def test_claims_are_judged_on_layouts_that_the_calibration_has_not_seen() -> None:
    seeds = [choices.layout_seed for choices in layouts(StudyConfig(layouts=20))]
    assert len(set(seeds)) == 20
    assert max(seeds) < CALIBRATED_FROM < FIRST_REFINED


def test_without_adjustments_the_users_of_the_lost_uav_get_nothing_and_the_others_less_interference() -> None:
    flown = compute(Job(replace(DRAWN, fading="mean"), BASELINE_2_FIXED, ("uav-2", None)))
    as_if_lost, as_planned = (flown.course(index).measures() for index in (0, 1))
    first = fly(replace(DRAWN, fading="mean").scenario(BASELINE_2_FIXED.utility), BASELINE_2_FIXED.method, None)
    assert as_planned["unadjusted"] == pytest.approx(as_planned["period_2"])
    others = np.sort(first.rates_kbps[:, -1])[::-1][:3]
    assert others[1:].sum() < as_if_lost["unadjusted"] < 2 * others.sum()
    assert as_if_lost["period_2"] >= as_if_lost["unadjusted"] - 1e-9, "the best user of more users is no worse"
