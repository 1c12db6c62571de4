"""The choice of altitudes between their limits, by what they are worth to the users."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import served_rates_bps
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.links import seen_aloft
from skyfolio.planner.ground.room import Room, highest_slopes
from skyfolio.planner.ground.thrift import come_home
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution

SHARES = (0.0, 0.5, 1.0)
"""Of the way from the floor to the ceiling: the altitudes that are tried."""
AFFORDED = (1.0, 0.75, 0.5, 0.25)
"""Of the way from the floor to the altitudes that are best: these are tried where energy does not suffice."""
MOST_CELLS = 2_000_000
"""U K N beyond which UAVs keep to the floor: trying costs U times that."""


def chosen_altitudes(problem: Problem, ground: Ground, room: Room, solution: Solution) -> Array:
    """Return altitudes (U, N) in the room, metres, at least as good as the floor for these paths and links.

    UAV by UAV the best of a few altitudes is taken in each slot, made climbable, and kept if the utility gains.
    """
    altitudes_m = room.floor_m.copy()
    if not ground.chooses or problem.snr_gain.size > MOST_CELLS:
        return altitudes_m
    rates = _rates_kbps(problem, ground, solution, altitudes_m)
    best = problem.utility_kbps(rates)
    for u in np.flatnonzero(np.isfinite(ground.high_m)).tolist():
        weights = rate_weights(problem, rates)
        tried = [_at_share(altitudes_m, room, u, share) for share in SHARES]
        worth = np.array([(weights * _rates_kbps(problem, ground, solution, one)).sum(axis=0) for one in tried])
        wanted = np.array([one[u] for one in tried])[worth.argmax(axis=0), np.arange(problem.n_slots)]
        wanted_m = highest_slopes(wanted[None], ground.climb_m[u : u + 1])[0]
        candidate = _affordable(problem, solution.paths_m, altitudes_m, u, wanted_m)
        reached = _rates_kbps(problem, ground, solution, candidate)
        utility = problem.utility_kbps(reached)
        if utility > best:
            altitudes_m, rates, best = candidate, reached, utility
    return altitudes_m


def _affordable(problem: Problem, paths_m: Array, altitudes_m: Array, u: int, wanted_m: Array) -> Array:
    """Return altitudes (U, N) with those of one UAV as high as wanted, or as near to it as its energy suffices for.

    Between altitudes that can be climbed from slot to slot, all can.
    """
    for share in AFFORDED:
        candidate = altitudes_m.copy()
        candidate[u] = wanted_m if share == 1.0 else altitudes_m[u] + share * (wanted_m - altitudes_m[u])
        if come_home(problem, paths_m, candidate)[u]:
            return candidate
    return altitudes_m


def _at_share(altitudes_m: Array, room: Room, u: int, share: float) -> Array:
    tried = altitudes_m.copy()
    tried[u] = room.floor_m[u] + share * np.maximum(room.ceiling_m[u] - room.floor_m[u], 0.0)
    return tried


def _rates_kbps(problem: Problem, ground: Ground, solution: Solution, altitudes_m: Array) -> Array:
    aloft = seen_aloft(problem, ground, solution.paths_m, altitudes_m)
    rates: Array = served_rates_bps(aloft, solution) / 1e3
    return rates
