"""The choice of altitudes between their limits, by what they are worth to the users."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.heard import Heard, heard
from skyfolio.planner.ground.room import Room, highest_slopes
from skyfolio.planner.ground.thrift import come_home
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution

SHARES = np.array([0.0, 0.5, 1.0])
"""Of the way from the floor to the ceiling: the altitudes that are tried."""
AFFORDED = (0.75, 0.5, 0.25)
"""Of the way from the floor to the altitudes that are best: these are tried where energy does not suffice."""
MOST_CELLS = 20_000_000
"""U K N beyond which UAVs keep to the floor: at worst trying costs so much, times the altitudes that are tried."""


def chosen_altitudes(problem: Problem, ground: Ground, room: Room, solution: Solution) -> Array:
    """Return altitudes (U, N) in the room, metres, at least as good as the floor for these paths and links.

    UAV by UAV the best of a few altitudes is taken in each slot, made climbable, and kept if the utility gains.
    """
    altitudes_m = room.floor_m.copy()
    if not ground.chooses or problem.snr_gain.size > MOST_CELLS:
        return altitudes_m
    links = heard(problem, ground, solution, altitudes_m)
    rates = links.table(links.rates_kbps(links.own, links.others))
    best = problem.utility_kbps(rates)
    for u in np.flatnonzero(np.isfinite(ground.high_m)).tolist():
        before = links.of(u, altitudes_m[u])
        wanted_m = _wanted(problem, ground, room, links, u, before, rates)
        row_m = _affordable(problem, solution.paths_m, altitudes_m, u, wanted_m)
        own, others = links.with_one(u, before, links.of(u, row_m))
        reached = links.table(links.rates_kbps(own, others))
        utility = problem.utility_kbps(reached)
        if utility > best:
            altitudes_m[u], links.own, links.others, rates, best = row_m, own, others, reached, utility
    return altitudes_m


def _wanted(
    problem: Problem, ground: Ground, room: Room, links: Heard, u: int, before: Array, rates_kbps: Array
) -> Array:
    """Return the lowest climbable altitudes (N,) of one UAV at or above the best of those tried in each slot, metres.

    before: (S, L), what it is heard with. rates_kbps: (K, N).
    """
    floor_m = room.floor_m[u]
    tried_m = floor_m + SHARES[:, None] * np.maximum(room.ceiling_m[u] - floor_m, 0.0)
    weights = rate_weights(problem, rates_kbps)[links.users, links.slots]
    worth = links.by_slot(weights * links.rates_kbps(*links.with_one(u, before, links.of(u, tried_m))))
    best_m = tried_m[worth.argmax(axis=0), np.arange(problem.n_slots)]
    wanted_m: Array = highest_slopes(best_m[None], ground.climb_m[u : u + 1])[0]
    return wanted_m


def _affordable(problem: Problem, paths_m: Array, altitudes_m: Array, u: int, wanted_m: Array) -> Array:
    """Return altitudes (N,) of one UAV as high as wanted, or as near to it as its energy suffices for, metres.

    Between altitudes that can be climbed from slot to slot, all can.
    """
    alone, now_m = problem.only(np.array([u])), altitudes_m[u]
    rows: list[Array] = [wanted_m, *(now_m + share * (wanted_m - now_m) for share in AFFORDED)]
    return next((row for row in rows if come_home(alone, paths_m[u : u + 1], row[None])[0]), now_m)
