"""Climbing when changes have a price: metres off given paths, and users that another UAV serves than before.

The climb of `climb.py` knows no price. Here the same ascent steers with the price of the metres in its objective (the
distance rounded off near 0, so that it has a slope everywhere), and links are made anew with the toll of every user
that changes UAVs: under `sum` by the assignment that is exact for these paths, else user by user, each change by what
it is really worth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import SUM, Arena, Links, arena_of, entry, links_of, plain
from skyfolio.planner.fast.ascent import ascend, ascent_of
from skyfolio.planner.fast.assigning import Tolls, Users, assigned, settled
from skyfolio.planner.fast.routes import with_routes
from skyfolio.planner.fast.seeds import flown
from skyfolio.planner.fast.served import as_asked, served_rates_bps
from skyfolio.planner.fast.trading import trade_links
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution
from skyfolio.planner.utility import SATED

STEPS, TOLERANCE = 30, 1e-7
SWEEPS = 6
SNAP = 2.0
"""A UAV within so many blurs of its old path is tried right on it."""


class PricedClimb:
    """Climbs one problem under tolls; `blur_m`: distances well below it hardly cost anything."""

    def __init__(self, problem: Problem, tolls: Tolls, blur_m: float) -> None:
        self._problem, self._tolls = problem, tolls
        self._arena = with_routes(problem, arena_of(problem))._replace(
            former=plain(tolls.former_m.transpose(1, 2, 0)),
            per_metre=float(tolls.per_metre),
            blur_m=float(blur_m),
            has_price=True,
        )

    def steps(self, solution: Solution) -> Iterator[Solution]:
        """Return the solution with links made anew, then with ways improved for those, then with links for these.

        Each may be worth less than the one before: the caller keeps the best.
        """
        linked = self._relinked(solution)
        yield linked
        steered = self._steered(linked)
        yield steered
        near = self._snapped(steered)
        if near is not None:
            yield self._relinked(near)

    def _relinked(self, solution: Solution) -> Solution:
        """Return the solution with the best links that are found at its paths when changes cost tolls."""
        problem, tolls, arena = self._problem, self._tolls, self._arena
        if arena.kind == SUM and not arena.has_floors:
            serving, hertz = assigned(problem, tolls, solution)
        else:
            serving, hertz = self._traded(solution)
        return replace(solution, serving=settled(problem, tolls, serving, hertz), bandwidth_hz=hertz)

    def _traded(self, solution: Solution) -> tuple[Users, Array]:
        tolls, path = self._tolls, plain(solution.paths_m.transpose(1, 2, 0))
        serving, khz = plain(solution.serving.T, np.int64).copy(), plain(solution.bandwidth_hz.T / 1e3).copy()
        before, served = plain(tolls.serving.T, np.int64), plain(tolls.served.T, np.bool_)
        for _ in range(SWEEPS):
            if trade_links(self._arena, path, serving, khz, before, served, tolls.per_user) == 0:
                break
        return np.ascontiguousarray(serving.T.astype(np.intp)), np.ascontiguousarray(khz.T * 1e3)

    def _steered(self, solution: Solution) -> Solution:
        """Return the solution with ways that an ascent reaches while all users keep their UAVs."""
        rates_kbps = served_rates_bps(self._problem, solution) / 1e3
        links = _links(self._arena, solution.serving, solution.bandwidth_hz, rates_kbps)
        path = plain(solution.paths_m.transpose(1, 2, 0)).copy()
        steer(self._arena, path, links, STEPS, TOLERANCE)
        hertz = np.zeros_like(solution.bandwidth_hz)
        for n, used in enumerate(links.used):
            hertz[links.user[n, :used], n] = links.khz[n, :used] * 1e3
        steered = replace(solution, paths_m=np.ascontiguousarray(path.transpose(2, 0, 1)), bandwidth_hz=hertz)
        return as_asked(self._problem, steered)

    def _snapped(self, solution: Solution) -> Solution | None:
        """Return the solution with UAVs right on their old paths where they are near; None if none is, or can be."""
        away = np.linalg.norm(solution.paths_m - self._tolls.former_m, axis=2, keepdims=True)
        near = (away > 0.0) & (away < SNAP * self._arena.blur_m)
        if not near.any():
            return solution
        path = flown(
            self._arena, plain(np.where(near, self._tolls.former_m, solution.paths_m).transpose(1, 2, 0)), chase=True
        )
        return None if path is None else replace(solution, paths_m=np.ascontiguousarray(path.transpose(2, 0, 1)))


def _links(arena: Arena, serving: Users, bandwidth_hz: Array, rates_kbps: Array) -> Links:
    """Return links as the ascent takes them: all users, or under `sum` those that have bandwidth."""
    links = links_of(arena)
    for n in range(links.used.shape[0]):
        users = np.flatnonzero(bandwidth_hz[:, n] > 0.0) if arena.kind == SUM else np.arange(len(serving))
        links.used[n] = len(users)
        links.user[n, : len(users)], links.uav[n, : len(users)] = users, serving[users, n]
        links.khz[n, : len(users)] = bandwidth_hz[users, n] / 1e3
        links.floor[n, : len(users)] = arena.min_kbps[users] if arena.has_minimum else 0.0
        if arena.has_demand:
            sated = rates_kbps[users, n] >= arena.demand[users] * (1.0 - SATED)
            links.floor[n, : len(users)] = np.where(sated, arena.demand[users], links.floor[n, : len(users)])
    return links


@entry
def steer(arena: Arena, path: Array, links: Links, steps: int, tolerance: float) -> int:
    """Improve `path` (N, 2, U) in place, links kept, by up to so many steps of the ascent; how many were made."""
    return ascend(arena, links, path, steps, tolerance, ascent_of(path, links))
