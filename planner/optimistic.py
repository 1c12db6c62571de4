"""Rates that no plan exceeds because nothing nearer, and nothing farther away, can be reached in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import reachable_boxes, squared_distance_range
from skyfolio.planner.sinr import mean_efficiency


def optimistic_rates_kbps(problem: Problem, slots: NDArray[np.intp] | None = None) -> Array:
    """Return the rate of each pair with a whole band, own UAV as near and the others as far as they can be.

    slots: (S,), which ones; default all. (U, K, S) kbit/s.
    """
    near2, far2 = squared_distance_range(problem, slots)
    most, least = problem.snr_range(near2, far2, slots)
    if problem.excess is not None:
        chosen = np.arange(problem.n_slots) if slots is None else slots
        better, worse = problem.excess.range_in(*reachable_boxes(problem, chosen), chosen)
        most, least = most * better, least * worse
    rates = mean_efficiency(most, least, problem.draws)
    rates *= (problem.bandwidth_hz / 1e3)[:, None, None]
    if problem.absent.size:
        rates *= problem.there if slots is None else problem.there[:, slots]
    return rates
