"""The constants of a vehicle's rotors, fitted to what it reports in flight: power against airspeed and climb."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.parts import Rotors

LEAST_SAMPLES = 30
"""With fewer the prior stands: a fit would be of noise."""
INDUCED_MPS = np.linspace(2.0, 14.0, 49)
"""Tried in turn: the law is linear in everything else but the speed of the tips, which enters with blade_w."""
PRIOR_SHARE = 1e-5
"""How much a relative change of a constant weighs beside a relative error of all samples: little, but it decides what
the airspeeds that were flown leave open."""
_MOST_TIP_MPS = 1000.0


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fitted constants. rms_w: what is left of the samples' power, W. samples: how many there were.

    least_mps, most_mps: the airspeeds between which the fit is one; outside of them it is the law's own shape.
    """

    rotors: Rotors
    rms_w: float
    samples: int
    least_mps: float
    most_mps: float


def fit_rotors(airspeed_mps: Array, climb_mps: Array, power_w: Array, prior: Rotors | None = None) -> Fit:
    """Return the constants that best explain the samples, by non-negative least squares; each array is (S,).

    airspeed_mps: horizontal; climb_mps: up is positive, descents enter as 0 and are better left out. prior: what is
    known of the vehicle otherwise (default: `Rotors()`); its rates of climb and descent are kept. Raises ValueError for
    fewer than `LEAST_SAMPLES`, for arrays of different lengths, and for numbers that are not finite.
    """
    known = prior or Rotors()
    samples = np.stack([airspeed_mps, climb_mps, power_w]).astype(float)
    if samples.shape[1] < LEAST_SAMPLES:
        raise ValueError(f"samples: {samples.shape[1]} are too few, at least {LEAST_SAMPLES} are needed")
    if not np.isfinite(samples).all():
        raise ValueError("samples: each must be finite")
    airspeed, climb, power = samples
    best, least = np.zeros(5), np.inf
    induced_mps = known.induced_mps
    for tried in INDUCED_MPS:
        constants, error = _linear(airspeed, np.maximum(climb, 0.0), power, known, float(tried))
        if error < least:
            best, least, induced_mps = constants, error, float(tried)
    rotors = _rotors(best, induced_mps, known)
    left = _columns(airspeed, np.maximum(climb, 0.0), induced_mps) @ best - power
    return Fit(
        rotors=rotors,
        rms_w=float(np.sqrt(np.mean(left**2))),
        samples=len(power),
        least_mps=float(airspeed.min()),
        most_mps=float(airspeed.max()),
    )


def _columns(airspeed: Array, climb: Array, induced_mps: float) -> Array:
    """Return what the constants are multiplied with, (S, 5): blade, its growth, induced, parasite and climb power."""
    ratio = airspeed**2 / (2.0 * induced_mps**2)
    induced = np.sqrt(np.sqrt(1.0 + ratio**2) - ratio)
    return np.stack([np.ones_like(airspeed), airspeed**2, induced, airspeed**3, climb], axis=1)


def _linear(airspeed: Array, climb: Array, power: Array, known: Rotors, induced_mps: float) -> tuple[Array, float]:
    """Return the five constants at this induced velocity, and what they leave unexplained of samples and prior."""
    growth = 3.0 * known.blade_w / known.tip_mps**2
    prior = np.array([known.blade_w, growth, known.induced_w, known.parasite_w_per_mps3, known.climb_w_per_mps])
    weight = float(np.mean(power)) * np.sqrt(PRIOR_SHARE * len(power)) / np.maximum(prior, 1e-9)
    rows = np.vstack([_columns(airspeed, climb, induced_mps), np.diag(weight)])
    found, error = nnls(rows, np.concatenate([power, weight * prior]))
    drawn = (induced_mps / known.induced_mps - 1.0) ** 2 * PRIOR_SHARE * len(power) * float(np.mean(power)) ** 2
    return found, float(error**2 + drawn)


def _rotors(constants: Array, induced_mps: float, known: Rotors) -> Rotors:
    blade, growth, induced, parasite, climb = constants.tolist()
    blade = max(blade, 1e-3)
    tip_mps = _MOST_TIP_MPS if growth <= 0.0 else min(_MOST_TIP_MPS, float(np.sqrt(3.0 * blade / growth)))
    return known.model_copy(
        update={
            "blade_w": blade,
            "tip_mps": tip_mps,
            "induced_w": induced,
            "induced_mps": induced_mps,
            "parasite_w_per_mps3": parasite,
            "climb_w_per_mps": climb,
        }
    )
