"""What altitudes cost of a battery: who comes home from them, and paths planned as if it held less by that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import ROUNDING_WH, account_of
from skyfolio.planner.energy.air import Air
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.room import room_over
from skyfolio.planner.problem import Problem


def come_home(problem: Problem, paths_m: Array, altitudes_m: Array) -> NDArray[np.bool_]:
    """Return which UAVs can stay where each slot of paths (U, N, 2) ends, and come home with their reserve: (U,).

    They can stay until their last slot, so that a replan finds them able to; one with an end position can go home at
    once. altitudes_m: (U, N), metres, at which the slots begin.
    """
    air = problem.air
    if air is None or not air.has_energy:
        return np.ones(len(paths_m), dtype=bool)
    afford: NDArray[np.bool_] = np.all(_spare_wh(problem, air, paths_m, altitudes_m) >= -ROUNDING_WH, axis=1)
    return afford


def _spare_wh(problem: Problem, air: Air, paths_m: Array, altitudes_m: Array | None) -> Array:
    """Return what is left above the reserve after staying where each slot ends, and coming home: (U, N) Wh."""
    margin_wh = account_of(air, paths_m, problem.n_flying, altitudes_m).margin_wh
    to_come = np.maximum(problem.n_flying[:, None] - 1 - np.arange(paths_m.shape[1]), 0)
    each_wh = np.where(np.isfinite(problem.end_m[:, 0]), 0.0, air.hover_wh())
    spare: Array = margin_wh - each_wh[:, None] * to_come
    return spare


def saving(problem: Problem, ground: Ground, paths_m: Array) -> Problem:
    """Return the problem with batteries that hold less, by what the altitudes of these paths (U, N, 2) cost.

    Those of UAVs that come home from these paths at their altitudes stay as they are, and each keeps enough to stay at
    its start.
    """
    air = problem.air
    if air is None or not air.has_energy:
        return problem
    level_wh = _spare_wh(problem, air, paths_m, None)
    aloft_wh = _spare_wh(problem, air, paths_m, room_over(ground, paths_m).floor_m)
    lacks = np.flatnonzero(np.any(aloft_wh < -ROUNDING_WH, axis=1))
    if not lacks.size:
        return problem
    idle_wh = account_of(air, problem.hover(), problem.n_flying).margin_wh.min(axis=1)
    less_wh = np.zeros(len(idle_wh))
    dearer_wh = (level_wh[lacks] - aloft_wh[lacks]).max(axis=1)
    less_wh[lacks] = np.minimum(dearer_wh, np.maximum(idle_wh[lacks], 0.0))
    return replace(problem, air=replace(air, budget_wh=air.budget_wh - less_wh))
