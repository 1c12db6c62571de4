"""Signal to interference plus noise: eq. (4) of the letter for a whole fleet."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import sum_of_others
from skyfolio.planner.problem import Problem


def spectral_efficiency(problem: Problem, paths_m: Array) -> Array:
    """Return log2(1 + SINR) of eq. (4), as if each UAV served each user: (U, K, N) bit/s/Hz.

    Every other UAV of the fleet interferes on the whole band, as in the letter.
    """
    snr = problem.snr(paths_m)
    return mean_efficiency(snr, snr, problem.draws)


def mean_efficiency(own_snr: Array, other_snr: Array, draws: Array) -> Array:
    """Return log2(1 + SINR) of each pair where UAVs are heard with these SNRs, the mean over draws: (U, K, N).

    own_snr, other_snr: (U, K, N), as the serving UAV and as an interferer. draws: (S, U, K) factors of both, or empty.
    """
    if not draws.size:
        efficiency: Array = np.log1p(own_snr / (1.0 + sum_of_others(other_snr))) / np.log(2)
        return efficiency
    none = np.zeros((0, 0, 0))
    total = np.zeros(own_snr.shape)
    for gains in draws[..., None]:
        total += mean_efficiency(own_snr * gains, other_snr * gains, none)
    return total / len(draws)
