"""From a nearly feasible path to one that satisfies (6d)-(6g) to the last bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem
from planner.separation import closest_approach

Array = NDArray[np.float64]
SHRINK = 1.0 - 1e-9
"""Steps are kept this much below `D_max`, so that rounding never carries one over it."""


def within_limits(problem: Problem, paths_m: Array) -> Array:
    """Clip each step to `D_max` and each point to the area, from the start on: (U, N, 2) metres.

    Clipping to a box does not stretch a step, so the speed limit survives it.
    """
    fixed = paths_m.copy()
    fixed[:, 0] = problem.start_m
    for n in range(1, problem.n_slots):
        move = paths_m[:, n] - fixed[:, n - 1]
        length = np.linalg.norm(move, axis=1)
        scale = np.minimum(1.0, problem.step_m * SHRINK / np.where(length > 0, length, 1.0))
        fixed[:, n] = np.clip(fixed[:, n - 1] + scale[:, None] * move, problem.low_m, problem.high_m)
    return fixed


def separated(problem: Problem, paths_m: Array) -> bool:
    """Whether no two UAVs come closer than `D_min`, at the slots and between them."""
    return closest_approach(paths_m) >= problem.separation_m


def toward(problem: Problem, feasible_m: Array, wanted_m: Array) -> Array:
    """The furthest of wanted, half way, a quarter, ... from a feasible path that is feasible; (U, N, 2) metres."""
    wanted_m = within_limits(problem, wanted_m)
    share = 1.0
    while share > 1e-3:
        candidate = within_limits(problem, feasible_m + share * (wanted_m - feasible_m))
        if separated(problem, candidate):
            return candidate
        share /= 2
    return feasible_m
