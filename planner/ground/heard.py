"""What the links of a solution are worth while the altitude of one UAV after the other is tried.

Only links with band count, and a UAV that changes its altitude changes what it alone is heard with: a trial costs as
much as there are links, however many UAVs there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.hidden import edges_of_lines
from skyfolio.planner.heard import factors
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution


@dataclass
class Heard:
    """L links, in any order; S draws of the fading, 1 without.

    users, slots, serving: (L,), of each link. hertz: (L,). ground_m: (L,), under its user. own: (S, L), with how much
    more than noise its user receives from the UAV that serves it; others: (S, L), noise and all other UAVs.
    """

    problem: Problem
    ground: Ground
    paths_m: Array
    users: NDArray[np.intp]
    slots: NDArray[np.intp]
    serving: NDArray[np.intp]
    hertz: Array
    ground_m: Array
    own: Array
    others: Array

    def of(self, u: int, altitude_m: Array) -> Array:
        """Return with how much more than noise a UAV at altitudes (..., N), metres, is heard: (..., S, L)."""
        problem, at = self.problem, np.minimum(self.slots, self.problem.user_m.shape[1] - 1)
        uav_m, user_m = self.paths_m[u, self.slots], problem.user_m[self.users, at]
        over2 = np.einsum("ld,ld->l", uav_m - user_m, uav_m - user_m) + problem.spread_m2[self.users, at]
        heights_m = altitude_m[..., self.slots] - self.ground_m
        gain = problem.snr_gain[u, self.users, self.slots] * self._factors(user_m, uav_m, over2, heights_m)
        snr: Array = (gain / (over2 + heights_m**2))[..., None, :]
        return snr * problem.draws[:, u, self.users] if problem.draws.size else snr

    def _factors(self, user_m: Array, uav_m: Array, over2: Array, heights_m: Array) -> Array | float:
        """Return by what the channel and hills differ from an inverse square: 1, or (..., L)."""
        ground = self.ground
        if ground.has_hills:
            edge = edges_of_lines(ground.terrain, user_m, uav_m, heights_m)
            return factors(ground.channel, over2, heights_m, edge, places_m=(user_m, uav_m))
        if self.problem.bends is None:
            return 1.0
        return factors(ground.channel, over2, heights_m, places_m=(user_m, uav_m))

    def with_one(self, u: int, before: Array, after: Array) -> tuple[Array, Array]:
        """Return `own` and `others`, (..., S, L), once one UAV is heard with `after` instead of `before`, as `of`."""
        its = self.serving == u
        return np.where(its, after, self.own), np.where(its, self.others, self.others + (after - before))

    def rates_kbps(self, own: Array, others: Array) -> Array:
        """Return the rate of each link, eqs. (1)-(4): (..., L) kbit/s."""
        rates: Array = self.hertz / 1e3 * np.log1p(own / others).mean(axis=-2) / np.log(2.0)
        return rates

    def table(self, of_links: Array) -> Array:
        """Return a value of each link (L,) as (K, N), 0 where there is none."""
        table = np.zeros((self.problem.n_users, self.problem.n_slots))
        table[self.users, self.slots] = of_links
        return table

    def by_slot(self, of_links: Array) -> Array:
        """Return the sums over the links of each slot, (T, L) to (T, N)."""
        return np.array([np.bincount(self.slots, weights=row, minlength=self.problem.n_slots) for row in of_links])


def heard(problem: Problem, ground: Ground, solution: Solution, altitudes_m: Array) -> Heard:
    """Return the links of a solution at altitudes (U, N), metres."""
    users, slots = np.nonzero(solution.bandwidth_hz > 0.0)
    at = np.minimum(slots, ground.user_ground_m.shape[1] - 1)
    serving = np.asarray(solution.serving[users, slots], dtype=np.intp)
    none = np.zeros((max(len(problem.draws), 1), len(users)))
    links = Heard(
        problem=problem,
        ground=ground,
        paths_m=solution.paths_m,
        users=users,
        slots=slots,
        serving=serving,
        hertz=solution.bandwidth_hz[users, slots],
        ground_m=ground.user_ground_m[users, at],
        own=none,
        others=none + 1.0,
    )
    for u, altitude_m in enumerate(altitudes_m):
        links.own, links.others = links.with_one(u, none, links.of(u, altitude_m))
    return links
