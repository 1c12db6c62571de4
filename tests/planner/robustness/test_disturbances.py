"""What is drawn: fading, wind, errors of position."""

import numpy as np
import pytest
from pydantic import ValidationError

from skyfolio.planner import EXAMPLES, Disturbances
from skyfolio.planner.channel import fading_gains

SCENARIO = EXAMPLES["paper"]().with_changes(slots=400)
CALM = Disturbances(wind_mps=0.0, gust_mps=0.0, position_noise_m=0.0)


def test_a_draw_depends_on_the_seed_and_its_number_alone() -> None:
    for one, other, same in ((CALM, CALM, True), (CALM, CALM.model_copy(update={"seed": 1}), False)):
        assert np.array_equal(one.gains(SCENARIO, 0, 3), other.gains(SCENARIO, 0, 3)) is same
    assert not np.array_equal(CALM.gains(SCENARIO, 0, 3), CALM.gains(SCENARIO, 0, 4))
    noisy = Disturbances()
    assert np.array_equal(noisy.errors_m(SCENARIO, 3), noisy.errors_m(SCENARIO, 3))
    assert not np.array_equal(noisy.errors_m(SCENARIO, 3), noisy.errors_m(SCENARIO, 4))


def test_fading_is_drawn_for_the_mean_channel_too_and_has_mean_1() -> None:
    gains = Disturbances().gains(SCENARIO, 0, 0)
    assert gains.shape == (3, 9, 400)
    assert gains.mean() == pytest.approx(1.0, abs=0.03)
    assert gains.std() > 0.3


def test_without_fading_the_channel_is_that_of_the_plan() -> None:
    sampled = SCENARIO.with_changes(channel=SCENARIO.channel.model_copy(update={"fading": "sampled", "seed": 8}))
    kept = Disturbances(fading=False).gains(sampled, 5, 2)
    assert np.array_equal(kept, fading_gains(sampled.channel, sampled.uav_ids, sampled.user_ids, 5, 400))


def test_errors_of_position_have_their_spread_and_change_slowly() -> None:
    errors = CALM.model_copy(update={"position_noise_m": 2.0}).errors_m(SCENARIO, 0)
    many = np.array([CALM.model_copy(update={"position_noise_m": 2.0}).errors_m(SCENARIO, d) for d in range(40)])
    assert errors.shape == (3, 400, 2)
    assert many.std() == pytest.approx(2.0, rel=0.1)
    assert many[:, :, 0].std() == pytest.approx(2.0, rel=0.2), "stationary from the first slot on"
    neighbours = np.corrcoef(many[:, :, 1:].ravel(), many[:, :, :-1].ravel())[0, 1]
    assert neighbours == pytest.approx(np.exp(-5.0 / 30.0), abs=0.05)


def test_a_steady_wind_pushes_all_uavs_alike_and_gusts_each_on_its_own() -> None:
    steady = CALM.model_copy(update={"wind_mps": 5.0}).errors_m(SCENARIO, 0)
    assert np.ptp(steady, axis=(0, 1)) == pytest.approx([0.0, 0.0])
    pushed = [np.hypot(*CALM.model_copy(update={"wind_mps": 5.0}).errors_m(SCENARIO, d)[0, 0]) for d in range(400)]
    assert np.mean(pushed) == pytest.approx(0.2 * 5.0, rel=0.1)
    gusty = CALM.model_copy(update={"gust_mps": 2.0}).errors_m(SCENARIO, 0)
    assert gusty.std() == pytest.approx(0.2 * 2.0, rel=0.1)


def test_a_calm_day_moves_nobody() -> None:
    assert not CALM.errors_m(SCENARIO, 0).any()


@pytest.mark.parametrize("wrong", [{"draws": 0}, {"wind_mps": -1.0}, {"position_noise_s": 0.0}, {"surprise": 1}])
def test_values_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        Disturbances.model_validate(wrong)
