"""What one more kbit/s is worth, user by user and slot by slot."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.utilities import kind_of
from skyfolio.planner.utility import SATED, TINY


def rate_weights(problem: Problem, rates_kbps: Array) -> Array:
    """Return the gradient of the utility in the planned rates: (K, N), all at least 0.

    rates_kbps: (K, N) of the planned slots; the past counts in the normalisation. Slots that do not count get 0.
    """
    counted = problem.counted_kbps(rates_kbps)
    if problem.mu == 0.0:
        slopes = np.repeat(problem.weight[:, None] / counted.shape[1], counted.shape[1], axis=1)
    else:
        kind = kind_of(problem.kind)
        rows = kind.rows(counted, problem.weight)
        counts = np.broadcast_to(kind.counts(counted.shape, problem.weight), rows.shape)
        times = np.isfinite(rows) * counts
        exponents = np.where(times > 0.0, problem.mu * rows, -np.inf)
        shares = _softmax(exponents, times) * (times.sum(axis=1, keepdims=True) / counts.sum(axis=1, keepdims=True))
        slopes = kind.spread(kind.scale(problem.weight)[:, None] * shares, counted.shape, problem.weight)
    planned = np.zeros(rates_kbps.shape)
    planned[:, problem.counted_from :] = slopes[:, problem.past_kbps.shape[1] :]
    if problem.has_demand:
        planned = planned * (rates_kbps < problem.demand_kbps[:, None] * (1.0 - SATED))
    return planned * problem.there


def log_weights(problem: Problem, rates_kbps: Array) -> Array:
    """Return the logarithm of what exp(mu rate) of each user weighs in the minorant that is exact at these rates: (K,).

    rates_kbps: (K, N). The greatest is 0. A user who has all it asks for in every slot weighs as little as any.
    """
    slopes = rate_weights(problem, rates_kbps)
    counts = slopes > 0.0
    logs = np.where(counts, np.log(np.where(counts, slopes, 1.0)) - problem.mu * rates_kbps, -np.inf).max(axis=1)
    known = np.isfinite(logs)
    least = float(logs.min(where=known, initial=np.inf)) if known.any() else 0.0
    logs = np.where(known, logs, least)
    weights: Array = logs - logs.max()
    return weights


def _softmax(exponents: Array, times: Array) -> Array:
    """Return the share of each entry in the sum of times exp(exponent) of its row; 0 in rows without any entry."""
    most = exponents.max(axis=1, keepdims=True)
    terms = times * np.exp(exponents - np.where(np.isfinite(most), most, 0.0))
    shares: Array = terms / np.maximum(terms.sum(axis=1, keepdims=True), TINY)
    return shares
