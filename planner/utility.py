"""Utilities of a rate table, and the measures that are reported with them.

Rates are kbit/s here, because mu is in 1/(kbit/s). The text of the letter optimises eq. (9), the exponential utility
of the SUM rate; its goal, eq. (5), is a mean-variance sum per USER. Both are available, and a third that also trades
between users. mu -> 0 is the mean sum rate for all three.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.utilities import kind_of

ONCE = np.ones((1, 1))
TINY = 1e-300
SATED = 1e-9
"""Relative: a user this little below what it asks for has it."""


def soft_mean(values: Array, mu: float) -> float:
    """Return (1/mu) log mean exp(mu x) over all entries, the certainty equivalent of eq. (7); the mean at mu = 0."""
    return float(soft_means(values.reshape(1, -1), mu)[0])


def soft_means(values: Array, mu: float, counts: Array = ONCE) -> Array:
    """Return `soft_mean` of each row of (R, N), evaluated so that neither a large nor a tiny |mu| loses digits.

    NaN marks slots in which a user was not there: the row is averaged over the others, and counts by
    their share, so that mu -> 0 is the mean sum rate here too. counts: (R, N) or broadcast to it, how often each entry
    counts.
    """
    there = np.isfinite(values)
    times = there * counts
    everything = np.broadcast_to(counts, values.shape).sum(axis=1)
    if mu == 0.0:
        return np.asarray((np.where(there, values, 0.0) * counts).sum(axis=1) / everything)
    count = times.sum(axis=1)
    least = np.where(there, values, np.inf).min(axis=1, keepdims=True)
    least[count == 0] = 0.0
    above = np.where(there, values, least) - least
    means: Array = least[:, 0] + np.log1p((np.expm1(mu * above) * counts).sum(axis=1) / np.maximum(count, TINY)) / mu
    means *= count / everything
    return means


def utility_kbps(rates_kbps: Array, kind: str, mu: float, weights: Array | None = None) -> float:
    """Return the utility of a (K, N) rate table, in kbit/s; NaN where a user was not there.

    `sum`: eq. (9), the soft mean over slots of the sum rate. `per_user`: the sum over users of the soft mean over
    slots of each user's rate, whose expansion is eq. (5). `pooled`: K times the soft mean over users and slots.
    weights: (K,), as how many users each counts; default 1.
    """
    named = kind_of(kind)
    weights = np.ones(len(rates_kbps)) if weights is None else weights
    means = soft_means(named.rows(rates_kbps, weights), mu, named.counts(rates_kbps.shape, weights))
    return float((named.scale(weights) * means).sum())


def mean_variance_kbps(
    rates_kbps: Array, mu: float, there: NDArray[np.bool_] | None = None, weights: Array | None = None
) -> float:
    """Return eq. (5) with beta = -mu/2: sum over users of mean minus beta times variance over slots, in kbit/s.

    there: (K, N), whether each user is there: mean and variance are over these slots, and the user counts by their
    share, and by its weight (K,).
    """
    if there is None or there.all():
        mean, variance, share = rates_kbps.mean(axis=1), rates_kbps.var(axis=1), 1.0
    else:
        slots = np.maximum(there.sum(axis=1), 1)
        mean = (rates_kbps * there).sum(axis=1) / slots
        variance = (((rates_kbps - mean[:, None]) ** 2) * there).sum(axis=1) / slots
        share = there.mean(axis=1)
    times = share * (1.0 if weights is None else weights)
    return float((times * mean).sum() + mu / 2 * (times * variance).sum())


def jain_index(rates_kbps: Array, there: NDArray[np.bool_] | None = None) -> float:
    """Return Jain's fairness index of the users' time-averaged rates: 1 is equal, 1/K is one user gets all.

    there: (K, N), whether each user is there: averages are over these slots, and over users who are there at all.
    """
    average = rates_kbps.mean(axis=1)
    if there is not None and not there.all():
        slots = there.sum(axis=1)
        average = (rates_kbps * there).sum(axis=1)[slots > 0] / slots[slots > 0]
    square_of_sum, sum_of_squares = average.sum() ** 2, (average**2).sum()
    return float(square_of_sum / (len(average) * sum_of_squares)) if sum_of_squares > 0 else 1.0
