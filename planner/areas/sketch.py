"""Where everybody hovers to begin with: coarsely for the whole fleet, then finely, region by region.

Both are the default method's sketches. The coarse ones look at a few users and settle who goes to which part of the
area; the fine ones look at many, with the other regions' UAVs on the flights of the coarse sketch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skyfolio.planner.areas.blocks import AreaProblem
from skyfolio.planner.areas.partition import Ints
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import arena_of, plain
from skyfolio.planner.fast.placement import Effort, places
from skyfolio.planner.problem import Problem
from skyfolio.planner.stopping import StoppingRule

COARSE_USERS, USERS = 4, 20
"""Users looked at for each UAV: which one in a neighbourhood is best is for the areas to find."""
COARSE_SKETCHES, COARSE_TRIES = 4, 20
SKETCHES, TRIES = 12, 100
"""Tries to settle the best sketch are for each UAV."""
REGION = 64
"""UAVs in a region, at most."""


def coarse_places(problem: Problem, seed: int, halted: Callable[[], bool]) -> Array:
    """Return hover points for the whole fleet, (U, 2) metres; its starts when there was no time for any."""
    users = drawn(problem.n_users, COARSE_USERS * problem.n_uavs, seed)
    arena = arena_of(problem.only(users=users))
    effort = Effort(COARSE_SKETCHES, 1, COARSE_TRIES * problem.n_uavs)
    found = places(arena, np.random.default_rng(seed), effort, halted=halted)
    return found[0].T.copy() if found else problem.start_m.copy()


@dataclass(frozen=True, kw_only=True)
class Place:
    """A region's task: hover points better than given_m, (U, 2) metres."""

    area: AreaProblem
    given_m: Array
    seed: int

    def run(self, stop: StoppingRule) -> Array | None:
        """Return the hover points (U, 2); None where none are clearly better."""

        def halted() -> bool:
            return stop([]) and stop.interrupts

        n_uavs = len(self.given_m)
        arena = arena_of(self.area.whole())
        given = np.concatenate([self.given_m.T, arena.start_m[:, n_uavs:]], axis=1)
        effort = Effort(SKETCHES, 1, TRIES * n_uavs)
        found = places(arena, np.random.default_rng(self.seed), effort, plain(given), halted=halted)
        return found[0].T[:n_uavs].copy() if found else None


def drawn(n_users: int, some: int, seed: int) -> Ints:
    """Return `some` of so many users, drawn at random; all of them where there are not that many."""
    if n_users <= some:
        return np.arange(n_users)
    return np.sort(np.random.default_rng(seed).choice(n_users, some, replace=False))
