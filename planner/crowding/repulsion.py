"""Positive definite minorants of 1 / (1 + D^2): mixtures of Bessel functions, checked, and tabulated by distance.

J0(w |x|) is positive definite on the plane for every w, and every radial function that is, is a mixture of them
(Schoenberg). Lengths are in units of the greatest altitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.special import j0, j1

from skyfolio.planner.arrays import Array

STEP = 0.015
"""Between two entries of the tables."""
NEAR_RINGS = (0.0, 0.03, 0.08, 0.15, 0.22, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)
"""Edges of the rings of distance between a UAV and its user within which a field is bounded by its slope."""
FAR_RINGS = (1.25, 1.6, 2.0, 2.8, 4.0, 6.0, 10.0)
"""The edges beyond, where each source is taken as far from the middle as it can be."""


@dataclass(frozen=True)
class Repulsion:
    """A positive definite kappa(D) = sum_w weight_w J0(frequency_w D) <= 1 / (1 + D^2) for D up to the table's end.

    value, slope, bend: (T,), kappa and its derivative at STEP, and the greatest second derivative in any direction
    within the outermost near ring. low: (F, T), the least kappa within half of the outer edge of each far ring.
    rings: (R + 1,), edges. share: (R,), the factor s of each ring's features. value_error, slope_error: what linear
    interpolation is off by at most.
    """

    frequency: Array
    weight: Array
    value: Array
    slope: Array
    bend: Array
    low: Array
    rings: Array
    share: Array
    value_error: float
    slope_error: float

    @property
    def at_zero(self) -> float:
        """kappa(0)."""
        return float(self.weight.sum())


def rings_until(farthest: float) -> Array:
    """Return the edges of the rings for distances up to `farthest`."""
    return np.array([*NEAR_RINGS, *(edge for edge in FAR_RINGS if edge < farthest), max(farthest, 1.1)])


def repulsion_of(frequency: Array, weight: Array, span: float, rings: Array) -> Repulsion:
    """Return the mixture scaled until it is a minorant, with its tables; weight >= 0. span: the greatest D."""
    distance = np.asarray(np.arange(int(span / STEP) + 3) * STEP, dtype=float)
    argument = np.outer(distance, frequency)
    bessel: Array = j0(argument)
    value = np.asarray(bessel @ weight, dtype=float)
    # Between two entries a function leaves its chord by at most STEP^2 / 8 times its second derivative.
    value_error = STEP**2 / 8 * float(weight @ frequency**2) / 2 + 1e-13
    excess = max(1e-9, _excess(distance, value + value_error))
    weight, value, value_error = weight / excess, value / excess, value_error / excess
    first = j1(argument)
    ratio = np.divide(first, argument, out=np.full(argument.shape, 0.5), where=argument > 0)
    slope = -(first * frequency) @ weight
    across, along = -(ratio * frequency**2) @ weight, -((bessel - ratio) * frequency**2) @ weight
    third = float(weight @ frequency**3)
    bend = _widest(np.maximum(np.abs(across), np.abs(along)), NEAR_RINGS[-1] / 2) + STEP * third
    far = rings[len(NEAR_RINGS) :]
    low = np.array([minimum_filter1d(value, _entries(edge / 2), mode="nearest") for edge in far]) - value_error
    low = low.reshape(len(far), len(value))
    share = _shares(distance, value + value_error, rings[1:])
    slope_error = STEP**2 / 8 * third + 1e-13
    return Repulsion(frequency, weight, value, slope, bend, low, rings, share, value_error, slope_error)


def _excess(distance: Array, upper: Array) -> float:
    """Return the greatest ratio of kappa and 1 / (1 + D^2), whose second derivative is at most 6 / (1 + D^2)^2."""
    wanted = 1.0 / (1.0 + distance**2)
    slack = STEP**2 / 8 * 6.0 * wanted[:-1] ** 2
    return float(max((upper[:-1] / (wanted[:-1] - slack)).max(), (upper[1:] / (wanted[1:] - slack)).max()))


def _shares(distance: Array, upper: Array, edges: Array) -> Array:
    """S >= 0 of each ring with s s' kappa(D) <= 1 / (1 + D^2 + ((r + r')/2)^2) for all D and all pairs of edges r, r'.

    It falls with the distance, so the outer edge of a ring stands for all of it.
    """
    highest = np.maximum(np.maximum(upper[:-1], upper[1:]), 1e-12)
    beyond = 1.0 + distance[1:] ** 2
    shares: list[float] = []
    for edge in edges:
        middle = ((edge + np.append(edges[: len(shares)], edge)) / 2) ** 2
        most = (1.0 / (highest * (beyond + middle[:, None]))).min(axis=1)
        before = [room / share for room, share in zip(most[:-1], shares, strict=True) if share > 0.0]
        shares.append(float(min([1.0, most[-1] ** 0.5, *before])))
    return np.array(shares)


def _entries(radius: float) -> int:
    return 2 * (int(radius / STEP) + 2) + 1


def _widest(values: Array, radius: float) -> Array:
    widest: Array = maximum_filter1d(values, _entries(radius), mode="nearest")
    return widest
