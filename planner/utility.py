"""Utilities of a rate table, and the measures that are reported with them.

Rates are kbit/s here, because mu is in 1/(kbit/s). The text of the letter optimises eq. (9), the exponential utility
of the SUM rate; its goal, eq. (5), is a mean-variance sum per USER. Both are available, and a third that also trades
between users. mu -> 0 is the mean sum rate for all three.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import softmax

from skyfolio.planner.arrays import Array
from skyfolio.planner.utilities import kind_of

if TYPE_CHECKING:
    from skyfolio.planner.problem import Problem


def soft_mean(values: Array, mu: float) -> float:
    """Return (1/mu) log mean exp(mu x) over all entries, the certainty equivalent of eq. (7); the mean at mu = 0."""
    return float(soft_means(values.reshape(1, -1), mu)[0])


def soft_means(values: Array, mu: float) -> Array:
    """Return `soft_mean` of each row of (R, N), evaluated so that neither a large nor a tiny |mu| loses digits.

    NaN marks slots in which a user was not there yet: the row is averaged over the others, and counts by
    their share, so that mu -> 0 is the mean sum rate here too.
    """
    there = np.isfinite(values)
    count = there.sum(axis=1)
    if mu == 0.0:
        return np.asarray(np.where(there, values, 0.0).mean(axis=1))
    least = np.where(there, values, np.inf).min(axis=1, keepdims=True)
    above = np.where(there, values, least) - least
    means: Array = least[:, 0] + np.log1p(np.expm1(mu * above).sum(axis=1) / count) / mu
    means *= count / values.shape[1]
    return means


def utility_kbps(rates_kbps: Array, kind: str, mu: float) -> float:
    """Return the utility of a (K, N) rate table, in kbit/s; NaN where a user was not there yet.

    `sum`: eq. (9), the soft mean over slots of the sum rate. `per_user`: the sum over users of the soft mean over
    slots of each user's rate, whose expansion is eq. (5). `pooled`: K times the soft mean over users and slots.
    """
    named = kind_of(kind)
    return float(named.scale(len(rates_kbps)) * soft_means(named.rows(rates_kbps), mu).sum())


def rate_weights(problem: Problem, rates_kbps: Array) -> Array:
    """Return the gradient of the utility in the planned rates: (K, N), all at least 0.

    rates_kbps: (K, N) of the planned slots; the past counts in the normalisation. Slots that do not count get 0.
    """
    counted = problem.counted_kbps(rates_kbps)
    if problem.mu == 0.0:
        weights = np.full(counted.shape, 1.0 / counted.shape[1])
    else:
        kind = kind_of(problem.kind)
        rows = kind.rows(counted)
        there = np.isfinite(rows)
        shares = softmax(np.where(there, problem.mu * rows, -np.inf), axis=1) * there.mean(axis=1, keepdims=True)
        weights = kind.scale(len(counted)) * kind.spread(shares, counted.shape)
    planned = np.zeros(rates_kbps.shape)
    planned[:, problem.counted_from :] = weights[:, problem.past_kbps.shape[1] :]
    return planned


def mean_variance_kbps(rates_kbps: Array, mu: float) -> float:
    """Return eq. (5) with beta = -mu/2: sum over users of mean minus beta times variance over slots, in kbit/s."""
    return float(rates_kbps.mean(axis=1).sum() + mu / 2 * rates_kbps.var(axis=1).sum())


def jain_index(rates_kbps: Array) -> float:
    """Return Jain's fairness index of the users' time-averaged rates: 1 is equal, 1/K is one user gets all."""
    average = rates_kbps.mean(axis=1)
    square_of_sum, sum_of_squares = average.sum() ** 2, (average**2).sum()
    return float(square_of_sum / (len(average) * sum_of_squares)) if sum_of_squares > 0 else 1.0
