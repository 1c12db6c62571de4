"""Positive definite minorants of 1 / phi(D): mixtures of Bessel functions, checked, and tabulated by distance.

J0(w |x|) is positive definite on the plane for every w, and every radial function that is, is a mixture of them
(Schoenberg). Lengths are in units of the greatest altitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import j0

from skyfolio.planner.arrays import Array

STEP = 0.015
"""Between two entries of the tables."""
RINGS = np.array([0.0, *np.geomspace(0.1, 100.0, 45)])
"""Edges (R,) of distance between a UAV and its user, from which on the cost of a pair is bounded by ring."""
FREQUENCIES = 24
SPACING = 0.8
"""Of the frequencies, so that pi / SPACING spans are the period of the slowest."""


@dataclass(frozen=True)
class Repulsion:
    """A positive definite kappa(D) = sum_w weight_w J0(frequency_w D) <= 1 / phi(D) for D up to the span.

    weight: (W,) of `frequencies`. value: (T,), kappa at multiples of STEP. room: (R,), s^2 of a UAV in each ring or
    farther out. value_error: what linear interpolation is off by at most.
    """

    weight: Array
    value: Array
    room: Array
    value_error: float

    @property
    def at_zero(self) -> float:
        """kappa(0)."""
        return float(self.weight.sum())


def frequencies(span: float) -> Array:
    """Return the frequencies of the Bessel functions that kappa is mixed of: (W,)."""
    return np.asarray(np.arange(FREQUENCIES) * (np.pi / (SPACING * span)), dtype=float)


def phi(distance: Array) -> Array:
    """Return what a pair of users so far apart is divided by at most, with the UAVs anywhere."""
    return np.asarray(np.exp(2.0 * np.arcsinh(distance / 2.0)), dtype=float)


def psi(least: float, distance: Array) -> Array:
    """Return the greatest (1 + (D + r)^2) / (1 + r^2) over r >= least: it rises until r^2 + D r = 1, then falls."""
    r = np.maximum(least, (np.sqrt(distance**2 + 4.0) - distance) / 2.0)
    return np.asarray((1.0 + (distance + r) ** 2) / (1.0 + r**2), dtype=float)


def repulsion_of(weight: Array, span: float) -> Repulsion:
    """Return the mixture of `frequencies` scaled until it is a minorant, with its tables; weight >= 0 (W,), not all 0.

    span: the greatest D.
    """
    tables = _tables(span)
    value = np.asarray(tables.waves @ weight, dtype=float)
    # Between two entries a function leaves its chord by at most STEP^2 / 8 times its second derivative.
    value_error = STEP**2 / 8 * float(weight @ frequencies(span) ** 2) / 2 + 1e-13
    # kappa is at most `highest` between two entries, where 1 / phi and 1 / psi are least at the end.
    highest = np.maximum(np.maximum(value[:-1], value[1:]) + value_error, 1e-12)
    excess = float((highest * tables.phi).max())
    room = excess / (highest * tables.pairs).max(axis=1)
    return Repulsion(weight / excess, value / excess, room, value_error / excess)


@dataclass(frozen=True)
class _Tables:
    """waves: (T, W), J0. phi: (T - 1,), from the second distance on. pairs: (R, T - 1), (1 + q^2) psi_q(D)."""

    waves: Array
    phi: Array
    pairs: Array


@lru_cache(maxsize=16)
def _tables(span: float) -> _Tables:
    distance = np.asarray(np.arange(int(span / STEP) + 3) * STEP, dtype=float)
    pairs = np.stack([(1.0 + edge**2) * psi(float(edge), distance[1:]) for edge in RINGS])
    return _Tables(j0(np.outer(distance, frequencies(span))), phi(distance[1:]), pairs)


def waves_of(span: float) -> Array:
    """Return J0 of each frequency at multiples of STEP: (T, W)."""
    return _tables(span).waves
