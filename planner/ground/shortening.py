"""Paths that no altitude makes safe are cut short: the UAV stays at the last point from which it is.

One that flies already, lower than its path asks for, may also climb at its start first and fly the path later. Paths
whose climbs leave too little energy to come home are cut short too: the planner of paths knows nothing of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner import fast
from skyfolio.planner.arrays import Array
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.room import room_over
from skyfolio.planner.ground.thrift import come_home
from skyfolio.planner.problem import Problem
from skyfolio.planner.repair import flyable, within_limits
from skyfolio.planner.unreachable import Blocked, UnreachableEndError

ROUNDING_M = 1e-6
AT_ONCE = 16
"""Shorter paths that are looked at together."""


def safe_over(problem: Problem, ground: Ground, paths_m: Array, known_m: Array | None = None) -> Array:
    """Return paths (U, N, 2), metres, that can be flown over the ground: the given ones, or cut short.

    The given paths keep all other limits of the problem. known_m: paths that were safe before, which are taken where
    cutting short does not help. Raises UnreachableEndError.
    """
    stuck = np.flatnonzero(~_is_safe(problem, ground, paths_m))
    for u in stuck.tolist():
        safer = next(_safer(problem, ground, paths_m, known_m, u), None)
        if safer is None:
            return _fallen_back(problem, ground, known_m, stuck)
        paths_m = safer
    return paths_m


def _safer(problem: Problem, ground: Ground, paths_m: Array, known_m: Array | None, u: int) -> Iterator[Array]:
    """Yield the paths with that of one UAV made safe: cut short, as late as possible first, or the known one."""
    alone, one = ground.of(np.array([u])), problem.only(np.array([u]))
    if problem.pinned_m.size and np.isfinite(problem.pinned_m[u]).any():
        return
    known = None if known_m is None else known_m[u]
    rows = _shorter(paths_m[u], int(ground.n_flying[u]), known, waits=bool(np.isfinite(ground.start_m[u])))
    for row in _climbable(alone, rows):
        if not _is_safe(one, alone, row[None]).all():
            continue
        candidate = paths_m.copy()
        candidate[u] = row
        candidate = within_limits(problem, candidate)
        is_kept = _is_close(candidate[u], row) and flyable(problem, candidate)
        if is_kept and _is_safe(one, alone, candidate[u : u + 1]).all():
            yield candidate


def _climbable(alone: Ground, rows_m: Iterator[Array]) -> Iterator[Array]:
    """Yield those paths (N, 2) of one UAV for which there are altitudes; `AT_ONCE` are looked at together."""
    while block := list(islice(rows_m, AT_ONCE)):
        room = room_over(alone.of(np.zeros(len(block), dtype=np.intp)), np.array(block))
        yield from (row for row, fits in zip(block, room.is_flyable(), strict=True) if fits)


def _shorter(path_m: Array, n_flying: int, known_m: Array | None, *, waits: bool) -> Iterator[Array]:
    """Yield paths (N, 2) that lose the last slots of this one, as few as possible first, then the known one.

    waits: also with as many slots of waiting at its start before it.
    """
    slots = np.arange(len(path_m))
    for lost in range(1, n_flying):
        last = n_flying - 1 - lost
        yield path_m[np.minimum(slots, last)]
        if waits and last:
            yield path_m[np.clip(slots - lost, 0, last)]
    if known_m is not None:
        yield known_m


def _fallen_back(problem: Problem, ground: Ground, known_m: Array | None, stuck: NDArray[np.intp]) -> Array:
    """Return the known paths of all, or hovering, whichever is safe. Raises UnreachableEndError if neither is."""
    is_pinned = bool(problem.pinned_m.size and np.isfinite(problem.pinned_m).any())
    for wanted_m in [] if is_pinned else [*([] if known_m is None else [known_m]), problem.hover()]:
        paths_m = fast.flyable(problem, wanted_m)
        if _is_safe(problem, ground, paths_m).all():
            return paths_m
    raise UnreachableEndError(Blocked("ground", tuple(stuck.tolist())))


def _is_safe(problem: Problem, ground: Ground, paths_m: Array) -> NDArray[np.bool_]:
    """Return for each UAV whether there are altitudes for its path, and energy to come home from the lowest: (U,)."""
    room = room_over(ground, paths_m)
    return room.is_flyable() & come_home(problem, paths_m, room.floor_m)


def _is_close(path_m: Array, wanted_m: Array) -> bool:
    """Return whether keeping the limits moved a path (N, 2) by no more than rounding."""
    return bool(np.abs(path_m - wanted_m).max() < ROUNDING_M)
