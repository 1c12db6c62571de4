"""Why no paths were found to the end positions: whom the zones keep from its end, or who cannot pass whom.

The search is the optimiser's own, on one UAV and then on two at a time: what it finds no way for alone, it finds none
for in the fleet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from planner.fast.arena import arena_of
from planner.fast.routes import with_routes
from planner.fast.seeds import hovering
from planner.problem import Problem

MOST_PAIRS = 500
"""So many pairs are tried at most: in a large fleet the message is then about the fleet."""


@dataclass(frozen=True)
class Blocked:
    """What stands in the way of an end position, for UAVs by their index: `zones` of one, each `other` of two."""

    by: Literal["zones", "other", "fleet"]
    uavs: tuple[int, ...] = ()


class UnreachableEndError(ValueError):
    """No paths were found that bring every UAV to its `end_m` by its last slot; `blocked` says who stands in the way.

    The message names UAVs by index until `named` puts in their ids.
    """

    def __init__(self, blocked: Blocked, ids: tuple[str, ...] | None = None) -> None:
        self.blocked = blocked
        super().__init__(_words(blocked, ids))

    def named(self, ids: tuple[str, ...]) -> UnreachableEndError:
        """Return the same error with the ids of the UAVs, in planning order, in its message."""
        return UnreachableEndError(self.blocked, ids)


def who_is_blocked(problem: Problem) -> Blocked:
    """Return the first UAV that finds no way alone, else the first two that find none together."""
    ending = [u for u in range(problem.n_uavs) if np.isfinite(problem.end_m[u, 0])]
    for u in ending:
        if _fails(problem, (u,)):
            return Blocked("zones", (u,))
    pairs = [pair for pair in combinations(range(problem.n_uavs), 2) if set(pair) & set(ending)]
    for pair in pairs[:MOST_PAIRS]:
        if _fails(problem, pair):
            return Blocked("other", pair)
    return Blocked("fleet")


def _fails(problem: Problem, uavs: tuple[int, ...]) -> bool:
    """Return whether these UAVs, with nobody else in the air, find no way to their ends."""
    few = list(uavs)
    part = replace(
        problem,
        start_m=problem.start_m[few],
        step_m=problem.step_m[few],
        altitude_m=problem.altitude_m[few],
        bandwidth_hz=problem.bandwidth_hz[few],
        snr_gain=problem.snr_gain[few],
        n_flying=problem.n_flying[few],
        end_m=problem.end_m[few],
    )
    return hovering(with_routes(part, arena_of(part))) is None


def _words(blocked: Blocked, ids: tuple[str, ...] | None) -> str:
    who = [f"UAV {u}" if ids is None else f"'{ids[u]}'" for u in blocked.uavs]
    if blocked.by == "zones":
        (u,) = blocked.uavs
        return f"uavs.{u}.end_m: {who[0]} finds no way around the no_fly zones to its end by its last slot"
    if blocked.by == "other":
        a, b = blocked.uavs
        return (
            f"uavs.{a}.end_m, uavs.{b}.end_m: {who[0]} and {who[1]} find no way past each other to their ends at "
            "min_separation_m, within area_m and by their last slots (eqs. 6d-6f)"
        )
    return "uavs: no paths found that bring every UAV to its end_m in time, although every two alone find theirs"
