"""Where a UAV can be in a slot at all, and how near to and far from each user it can be there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem

UNLIMITED_MPS = 1e9
"""Stands for an airspeed that nothing limits."""


@dataclass(frozen=True)
class Reach:
    """A superset of the positions each UAV can take in each slot: two discs and the flying area, intersected.

    from_start_m, to_end_m: (U, N), radii in metres of the disc around the start (eqs. 6d, 6g) and, where there is an
    end position, around that end (infinite where not). The centres are in the problem.
    """

    from_start_m: Array
    to_end_m: Array


def reach_of(problem: Problem) -> Reach:
    """Return the discs: `n D_max` around the start, `(last slot - n) D_max` around the end.

    A UAV that has left keeps its last disc.
    """
    slot = np.arange(problem.n_slots)[None]
    last = problem.n_flying[:, None] - 1
    step = problem.step_m[:, None]
    from_start: Array = step * np.minimum(slot, last)
    to_end = np.where(np.isnan(problem.end_m[:, :1]), np.inf, step * np.maximum(last - slot, 0.0))
    return Reach(from_start, np.asarray(to_end, dtype=float))


def reachable_boxes(problem: Problem, slots: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return boxes that hold all that each UAV can reach in some slots (S,): corners low and high, (U, S, 2) metres."""
    reach = reach_of(problem)
    low, high = (np.broadcast_to(corner, (problem.n_uavs, len(slots), 2)) for corner in (problem.low_m, problem.high_m))
    end_m = np.where(np.isnan(problem.end_m), 0.0, problem.end_m)
    for centre_m, radius_m in ((problem.start_m, reach.from_start_m), (end_m, reach.to_end_m)):
        radius = radius_m[:, slots, None]
        low, high = np.maximum(low, centre_m[:, None] - radius), np.minimum(high, centre_m[:, None] + radius)
    return low, high


def squared_distance_range(
    problem: Problem, slots: NDArray[np.intp] | None = None, *, ends: bool = True
) -> tuple[Array, Array]:
    """Return bounds of `d_uk^2[n]` over the reachable positions: a lower and an upper one, each (U, K, S) in m^2.

    slots: (S,), which ones; default all. ends: whether to count that end positions must be reached in time.
    """
    reach = reach_of(problem)
    chosen = np.arange(problem.n_slots) if slots is None else slots
    still = problem.user_m.shape[1] == 1
    user = problem.user_m if still else problem.user_m[:, chosen]  # (K, S or 1, 2)
    spread_m2 = problem.spread_m2 if still else problem.spread_m2[:, chosen]
    near = np.linalg.norm(user - np.clip(user, problem.low_m, problem.high_m), axis=-1)[None]  # to the area
    far = np.linalg.norm(np.maximum(user - problem.low_m, problem.high_m - user), axis=-1)[None]  # to its corners
    near, far = _by_air(problem, chosen, user, near, far)
    discs = [(problem.start_m, reach.from_start_m[:, chosen])]
    if ends:
        discs.append((problem.end_m, reach.to_end_m[:, chosen]))
    for centre_m, radius_m in discs:
        away = np.linalg.norm(user - np.where(np.isnan(centre_m), 0.0, centre_m)[:, None, None], axis=-1)
        near = np.maximum(near, away - radius_m[:, None, :])
        far = np.minimum(far, away + radius_m[:, None, :])
    height2 = problem.altitude_m[:, None, None] ** 2 + spread_m2
    return near**2 + height2, far**2 + height2


def _by_air(problem: Problem, slots: NDArray[np.intp], user: Array, near: Array, far: Array) -> tuple[Array, Array]:
    """Return tighter distances to users, (U, K, S) metres: what wind carries a UAV to, and how far it flies from there.

    user: (K, S or 1, 2), where they are.

    After n slots it is in a disc of n times its way through the air around where n slots of wind alone carry it.
    """
    air = problem.air
    if air is None or not air.has_wind:
        return near, far
    flown = np.minimum(slots[None], problem.n_flying[:, None] - 1)  # (U, S)
    drifted = problem.start_m[:, None] + flown[..., None] * air.wind_mps * air.slot_s
    away = np.linalg.norm(user - drifted[:, None], axis=-1)  # (U, K, S)
    through_m = np.minimum(air.airspeed_mps - air.gust_mps, UNLIMITED_MPS) * air.slot_s
    radius = (flown * through_m[:, None])[:, None]
    return np.maximum(near, away - radius), np.minimum(far, away + radius)
