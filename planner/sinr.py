"""Signal to interference plus noise: eq. (4) of the letter for a whole fleet."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import squared_distances, sum_of_others
from skyfolio.planner.problem import Problem


def spectral_efficiency(problem: Problem, paths_m: Array) -> Array:
    """Return log2(1 + SINR) of eq. (4), as if each UAV served each user: (U, K, N) bit/s/Hz.

    Every other UAV of the fleet interferes on the whole band, as in the letter.
    """
    snr = problem.snr_gain / squared_distances(paths_m, problem.user_m, problem.altitude_m)
    efficiency: Array = np.log1p(snr / (1.0 + sum_of_others(snr))) / np.log(2)
    return efficiency
