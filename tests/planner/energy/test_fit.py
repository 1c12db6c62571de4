"""Constants that are fitted to reports explain them, and what was not flown stays as it was known."""

import numpy as np
import pytest

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.fit import LEAST_SAMPLES, fit_rotors
from skyfolio.planner.energy.power import law_of
from skyfolio.planner.scenario import Rotors

TRUE = Rotors(blade_w=61.5, tip_mps=90.0, induced_w=135.7, induced_mps=6.29, parasite_w_per_mps3=0.018)


def reports(n: int, seed: int, most_mps: float = 14.0, noise_w: float = 3.0) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    airspeed, climb = rng.uniform(0.0, most_mps, n), np.where(rng.random(n) < 0.2, 2.0, 0.0)
    power = law_of([TRUE]).expected_w(airspeed) + TRUE.climb_w_per_mps * climb + rng.normal(0.0, noise_w, n)
    return airspeed, climb, power


def test_a_fit_predicts_the_power_of_every_airspeed_that_was_flown() -> None:
    fit = fit_rotors(*reports(600, seed=1))
    over = np.linspace(0.0, 14.0, 50)
    off = law_of([fit.rotors]).expected_w(over) / law_of([TRUE]).expected_w(over) - 1.0
    assert np.abs(off).max() < 0.02
    assert fit.rotors.climb_w_per_mps == pytest.approx(TRUE.climb_w_per_mps, rel=0.1)
    assert fit.rms_w == pytest.approx(3.0, rel=0.2)
    assert (fit.samples, fit.least_mps >= 0.0, fit.most_mps <= 14.0) == (600, True, True)


def test_what_was_not_flown_keeps_what_is_known_of_the_vehicle() -> None:
    hovering = (np.zeros(100), np.zeros(100), np.full(100, 1.2 * (79.86 + 88.63)))
    fit = fit_rotors(*hovering)
    known, found = law_of([Rotors()]), law_of([fit.rotors])
    assert found.expected_w(np.zeros(1))[0] == pytest.approx(hovering[2][0], rel=0.01)
    assert found.expected_w(np.full(1, 12.0))[0] == pytest.approx(1.2 * known.expected_w(np.full(1, 12.0))[0], rel=0.1)


def test_too_few_reports_and_reports_that_are_no_numbers_are_refused() -> None:
    airspeed, climb, power = reports(LEAST_SAMPLES - 1, seed=2)
    with pytest.raises(ValueError, match="are too few"):
        fit_rotors(airspeed, climb, power)
    airspeed, climb, power = reports(LEAST_SAMPLES, seed=2)
    with pytest.raises(ValueError, match="must be finite"):
        fit_rotors(airspeed, climb, np.full(LEAST_SAMPLES, np.nan))
