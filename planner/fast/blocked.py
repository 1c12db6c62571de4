"""Why no paths were found to the end positions: whom the zones keep from its end, or who cannot pass whom.

The search is the optimiser's own, on one UAV and then on two at a time: what it finds no way for alone, it finds none
for in the fleet.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from skyfolio.planner.fast.arena import arena_of
from skyfolio.planner.fast.routes import with_routes
from skyfolio.planner.fast.seeds import hovering
from skyfolio.planner.problem import Problem
from skyfolio.planner.unreachable import Blocked

MOST_PAIRS = 500
"""So many pairs are tried at most: in a large fleet the message is then about the fleet."""


def who_is_blocked(problem: Problem) -> Blocked:
    """Return the first UAV that finds no way alone, else the first two that find none together."""
    ending = [u for u in range(problem.n_uavs) if np.isfinite(problem.end_m[u, 0])]
    for u in ending:
        if _fails(problem, (u,)):
            return Blocked("zones" if _fails(_with_full_batteries(problem), (u,)) else "energy", (u,))
    pairs = [pair for pair in combinations(range(problem.n_uavs), 2) if set(pair) & set(ending)]
    for pair in pairs[:MOST_PAIRS]:
        if _fails(problem, pair):
            return Blocked("other", pair)
    return Blocked("fleet")


def _with_full_batteries(problem: Problem) -> Problem:
    """Return the problem without any limit of energy."""
    return problem if problem.air is None else replace(problem, air=problem.air.without_limits())


def _fails(problem: Problem, uavs: tuple[int, ...]) -> bool:
    """Return whether these UAVs, with no other UAV in the air, find no way to their ends."""
    part = problem.only(uavs=np.array(uavs))
    return hovering(with_routes(part, arena_of(part))) is None
