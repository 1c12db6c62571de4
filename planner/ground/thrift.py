"""What altitudes cost of a battery: who comes home from them, and paths planned as if it held less by that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import ROUNDING_WH, account_of
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.room import room_over
from skyfolio.planner.problem import Problem


def come_home(problem: Problem, paths_m: Array, altitudes_m: Array) -> NDArray[np.bool_]:
    """Return which UAVs can go home from the end of each slot of paths (U, N, 2), with their reserve: (U,).

    altitudes_m: (U, N), metres, at which the slots begin.
    """
    air = problem.air
    if air is None or not air.has_energy:
        return np.ones(len(paths_m), dtype=bool)
    margin_wh = account_of(air, paths_m, problem.n_flying, altitudes_m).margin_wh
    afford: NDArray[np.bool_] = np.all(margin_wh >= -ROUNDING_WH, axis=1)
    return afford


def saving(problem: Problem, ground: Ground, paths_m: Array) -> Problem:
    """Return the problem with batteries that hold less, by what the altitudes of these paths (U, N, 2) cost.

    Those of UAVs that come home from these paths at their altitudes stay as they are, and each keeps enough to stay at
    its start.
    """
    air = problem.air
    if air is None or not air.has_energy:
        return problem
    level_wh = account_of(air, paths_m, problem.n_flying).margin_wh
    aloft_wh = account_of(air, paths_m, problem.n_flying, room_over(ground, paths_m).floor_m).margin_wh
    lacks = np.flatnonzero(np.any(aloft_wh < -ROUNDING_WH, axis=1))
    if not lacks.size:
        return problem
    idle_wh = account_of(air, problem.hover(), problem.n_flying).margin_wh.min(axis=1)
    less_wh = np.zeros(len(idle_wh))
    dearer_wh = (level_wh[lacks] - aloft_wh[lacks]).max(axis=1)
    less_wh[lacks] = np.minimum(dearer_wh, np.maximum(idle_wh[lacks], 0.0))
    return replace(problem, air=replace(air, budget_wh=air.budget_wh - less_wh))
