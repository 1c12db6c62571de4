"""Rates averaged over draws of the fading, and their gradient: what `rates.py` computes in one draw, in S at once.

log2(1 + SINR) is taken in every draw and then averaged. The links of a slot are chosen by SINR alone, so that for them
a pair is represented by the one SINR that gives its mean rate: association and bandwidth are then as exact as in one
draw, since their rates are linear in the mean spectral efficiencies.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, kernel, smooth

TOTAL = 1e30
"""What every user receives in all in the equivalent signals: only their shares of it have a meaning."""
AT_ONCE = 4
"""Of so many draws the ratios are multiplied before a logarithm is taken: logarithms take most of the time."""


@smooth
def draw_signals(signal: Array, draws: Array, u: int, own: Array, others: Array) -> None:
    """SNR of UAV u into `own`, 1 + the sum of all others' into `others`, both (S,).

    signal: (U,), the SNRs of a mean channel at one user; draws: (U, S), their factors.
    """
    for s in range(own.shape[0]):
        own[s] = signal[u] * draws[u, s]
        others[s] = 1.0
    for i in range(signal.shape[0]):
        if i == u:
            continue
        for s in range(own.shape[0]):
            others[s] += signal[i] * draws[i, s]


@smooth
def mean_log(own: Array, others: Array) -> float:
    """Return the mean of log(1 + own / others) over draws, both (S,)."""
    total, product = 0.0, 1.0
    for s in range(own.shape[0]):
        product *= (own[s] + others[s]) / others[s]
        if s % AT_ONCE == AT_ONCE - 1:
            total += np.log(product)
            product = 1.0
    return float((total + np.log(product)) / own.shape[0])


@smooth
def equivalent_signals(arena: Arena, at: Array, n: int, signal: Array, total: Array) -> None:
    """Signals (U, K) and totals (K,) of slot n that give in one draw each pair's mean rate. at: (2, U), positions."""
    n_uavs, n_users = signal.shape
    n_draws = arena.draws.shape[2]
    here = arena.user_m[n * arena.per_slot]
    mean, own, others = np.empty(n_uavs), np.empty(n_draws), np.empty(n_draws)
    for k in range(n_users):
        for u in range(n_uavs):
            de, dn = at[0, u] - here[0, k], at[1, u] - here[1, k]
            mean[u] = arena.gain[n, u] / (de * de + dn * dn + (arena.height2[u] + here[2, k]))
        equivalent_of(mean, arena.draws[k], own, others, signal, total, k)


@smooth
def equivalent_of(mean: Array, draws: Array, own: Array, others: Array, signal: Array, total: Array, k: int) -> None:
    """Write the equivalents at user k of SNRs (U,) of a mean channel. draws: (U, S); own, others: (S,), scratch."""
    total[k] = TOTAL
    for u in range(mean.shape[0]):
        signal[u, k] = 0.0
        if mean[u] > 0.0:
            draw_signals(mean, draws, u, own, others)
            signal[u, k] = -TOTAL * np.expm1(-mean_log(own, others))


@kernel
def pull_draws(
    path: Array,
    slope: Array,
    n: int,
    u: int,
    east: float,
    north: float,
    scale: float,
    draws: Array,
    own: Array,
    others: Array,
    near: Array,
    signal: Array,
) -> None:
    """Add the slope of one link's mean rate: the mean of what `links_narrow.pull_link` adds in each draw."""
    n_draws = own.shape[0]
    for i in range(near.shape[0]):
        if i == u:
            continue
        push = 0.0
        for s in range(n_draws):
            push += draws[i, s] * own[s] / ((own[s] + others[s]) * others[s])
        strength = 2.0 * scale * push / n_draws * signal[i] * near[i]
        slope[n, 0, i] += strength * (path[n, 0, i] - east)
        slope[n, 1, i] += strength * (path[n, 1, i] - north)
    pull = 0.0
    for s in range(n_draws):
        pull += own[s] / (own[s] + others[s])
    strength = 2.0 * scale * pull / n_draws * near[u]
    slope[n, 0, u] -= strength * (path[n, 0, u] - east)
    slope[n, 1, u] -= strength * (path[n, 1, u] - north)
