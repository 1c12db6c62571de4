"""A finished plan as arrays, with what each rate and each hertz is worth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.pinning import pinned
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import Past, Problem, problem_of
from skyfolio.planner.remainder import remaining
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.utility import SATED

LN2 = float(np.log(2.0))


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """A plan as arrays; U UAVs, K users, N slots.

    problem: held to the plan's pins. paths_m: (U, N, 2) metres. serving: (K, N) UAV index. bandwidth_hz, rates_kbps:
    (K, N).
    """

    plan: Plan
    scenario: Scenario
    past: Past
    problem: Problem
    paths_m: Array
    serving: NDArray[np.intp]
    bandwidth_hz: Array
    rates_kbps: Array

    @classmethod
    def of(cls, plan: Plan) -> Self:
        """Return the arrays of this plan, with the past that counts in its utility."""
        scenario, past = remaining(plan, (), plan.first_slot)
        index = {uav: u for u, uav in enumerate(scenario.uav_ids)}
        users = scenario.user_ids
        held = pinned(scenario, plan.pins)
        problem = replace(problem_of(scenario, past), pinned_m=held.paths_m, pinned_to=held.serving)
        return cls(
            plan=plan,
            scenario=scenario,
            past=past,
            problem=problem,
            paths_m=np.array([plan.trajectories_m[uav] for uav in scenario.uav_ids]),
            serving=np.array([[index[uav] for uav in plan.association[user]] for user in users], dtype=np.intp),
            bandwidth_hz=np.array([plan.bandwidth_hz[user] for user in users]),
            rates_kbps=np.array([plan.user_rates_bps[user] for user in users]) / 1e3,
        )

    def is_pinned(self, u: int) -> bool:
        """Return whether the path of UAV `u` is given."""
        return bool(self.problem.pinned_m.size) and bool(np.isfinite(self.problem.pinned_m[u, 0, 0]))

    @cached_property
    def may_serve(self) -> NDArray[np.bool_]:
        """Whether a user is there, and pins let a UAV serve it: (U or 1, K, N), or (1, 1, 1) where all may always."""
        given = self.problem.pinned_to
        if not given.size:
            return np.asarray(self.problem.there[None] if self.problem.absent.size else np.ones((1, 1, 1), dtype=bool))
        uavs = np.arange(self.problem.n_uavs)[:, None, None]
        allowed: NDArray[np.bool_] = ((given < 0) | (given == uavs)) & self.problem.there
        return allowed

    @cached_property
    def weights(self) -> Array:
        """The gradient of the utility in the rates: (K, N)."""
        return rate_weights(self.problem, self.rates_kbps)

    @cached_property
    def earned_kbps(self) -> Array:
        """What each UAV's band is worth in each slot to first order: (U, N), kbit/s of utility.

        Rates are proportional to bandwidth, so the gradient times the rates is what a relative change of the band
        changes, and, at the best shares, what a hertz is worth times the band. Who has all that it asks for takes no
        more of a wider band: all of it goes to the others.
        """
        earned = self.by_uav(self.weights * self.rates_kbps)
        if not self.problem.has_demand:
            return earned
        taking_hz = self.by_uav(self.bandwidth_hz * (self.weights > 0.0))
        return earned * (self.problem.bandwidth_hz[:, None] / np.where(taking_hz > 0.0, taking_hz, np.inf))

    def by_uav(self, of_users: Array) -> Array:
        """Return the sums (U, N) of what users have, (K, N), over the users of each UAV."""
        sums = np.zeros((self.problem.n_uavs, self.problem.n_slots))
        slots = np.broadcast_to(np.arange(self.problem.n_slots), self.serving.shape)
        np.add.at(sums, (self.serving, slots), of_users)
        return sums

    @cached_property
    def total_snr(self) -> Array:
        """The sum of all signals over noise at each user: (K, N)."""
        total = np.zeros((self.problem.n_users, self.problem.n_slots))
        for u in range(self.problem.n_uavs):
            total += self.snr_of(u)
        return total

    @cached_property
    def own_snr(self) -> Array:
        """The signal over noise of the UAV that serves each user: (K, N)."""
        own = np.zeros((self.problem.n_users, self.problem.n_slots))
        for u in range(self.problem.n_uavs):
            own += np.where(self.serving == u, self.snr_of(u), 0.0)
        return own

    @cached_property
    def has_all_it_asks_for(self) -> NDArray[np.bool_]:
        """Whether each user gets what it asks for in every slot in which it is there: (K,)."""
        asked = self.problem.demand_kbps[:, None] * (1.0 - SATED)
        return np.asarray(((self.rates_kbps >= asked) | ~self.problem.there).all(axis=1))

    def over_time(self, rates: Array, users: NDArray[np.intp] | None = None) -> Array:
        """Return the mean of (k, N) rates of these users, by default all, over the slots in which each is there."""
        if not self.problem.absent.size:
            return np.asarray(rates.mean(axis=1))
        there = self.problem.there if users is None else self.problem.there[users]
        return np.asarray((rates * there).sum(axis=1) / np.maximum(there.sum(axis=1), 1))

    def snr_of(self, u: int, path_m: Array | None = None, users: NDArray[np.intp] | None = None) -> Array:
        """Return the signal over noise of UAV `u` on its path, or on another (N, 2) in metres: (K, N)."""
        path = self.paths_m[u] if path_m is None else path_m
        chosen = slice(None) if users is None else users
        user_m, spread_m2 = self.problem.user_m[chosen], self.problem.spread_m2[chosen]
        east, north = (path[:, axis] - user_m[:, :, axis] for axis in (0, 1))
        over2 = east * east + north * north
        height2 = self.problem.altitude_m[u] ** 2 + spread_m2
        bent, _ = self.problem.bent(u, over2 + spread_m2)
        snr: Array = self.problem.snr_gain[u, chosen] / (over2 + height2) * bent
        excess = self.problem.excess
        return snr if excess is None else snr * excess.of_uav(u, path, chosen)[0]

    def utility_kbps(self, rates_kbps: Array) -> float:
        """Return the utility of another rate table (K, N) of the same slots, in kbit/s."""
        return self.problem.utility_kbps(rates_kbps)
