"""An area's problem, with everybody else as they fly; a task of its own, to be run anywhere.

The default method knows nothing of areas. What is outside enters its problem exactly, by what it has already:

*Interference.* A user at whom x arrives (1 + everything outside, in units of the noise) has the SINR s / (x + i) =
(s / x) / (1 + i / x): all gains to it are divided by x, slot by slot.
*The sum rate of the others*, on which the weight of a slot depends under `sum` at mu < 0: one more UAV with one more
user, out of everybody's earshot, whose link carries just that.
*The users of the others*, who weigh in the one expectation of `pooled`: one past slot with one rate that amounts to
the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.areas.noise import heard
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import linked, optimise
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution
from skyfolio.planner.stopping import StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError

EFFICIENCY = 8.0
"""bit/s/Hz at most of the link that stands for the others."""
FAR_M = 1e7


@dataclass(frozen=True, kw_only=True)
class Outside:
    """What flies outside an area: gain (V, N) m^2, paths_m (V, N, 2), altitude_m (V,).

    serves: (K, N), when one of these serves the area's users, who cannot have another UAV then. sum_kbps: (N,), the sum
    rate of all links that are not the area's. decayed: of the users not in its problem the sum of exp(mu rate).
    """

    gain: Array
    paths_m: Array
    altitude_m: Array
    serves: NDArray[np.bool_]
    sum_kbps: Array
    decayed: float


@dataclass(frozen=True, kw_only=True)
class AreaProblem:
    """problem: of the area's UAVs and users, its `snr_gain` (U, 1, N) as without any UAV outside."""

    problem: Problem
    outside: Outside

    def whole(self) -> Problem:
        """Return the problem with everything outside in it."""
        problem, outside = self.problem, self.outside
        noise = heard(outside.gain, outside.paths_m, outside.altitude_m, problem.mean_user_m)
        made = replace(problem, snr_gain=problem.snr_gain / noise[None] * ~outside.serves[None])
        if problem.mu == 0.0 or problem.kind == "per_user":
            return made
        return _with_rest(made, outside.sum_kbps) if problem.kind == "sum" else _with_users(made, outside.decayed)


class Task(Protocol):
    """Something to do for an area, that needs nothing but itself, and can be sent to another process."""

    def run(self, stop: StoppingRule) -> Any:
        """Return what comes of it; None for nothing better."""
        ...


Runner: TypeAlias = Callable[[Sequence[Task]], list[Any]]
"""Runs tasks anywhere, and returns what each found, in order: None for those that it had no time for."""


@dataclass(frozen=True, kw_only=True)
class Improve:
    """Plan an area anew from the paths that it has, start_m (U, N, 2)."""

    area: AreaProblem
    start_m: Array
    n_starts: int
    seed: int

    def run(self, stop: StoppingRule) -> Solution | None:
        """Return the best that is found; None where no flyable path is."""
        problem = self.area.whole()
        start_m = self.start_m
        if problem.n_uavs > len(start_m):
            start_m = np.concatenate([start_m, problem.pinned_m[len(start_m) :]])
        try:
            return optimise(problem, stop, start_m, n_starts=self.n_starts, seed=self.seed)
        except UnreachableEndError:
            return None


@dataclass(frozen=True, kw_only=True)
class Link:
    """Find the best association and bandwidth of an area at its paths, paths_m (U, N, 2)."""

    area: AreaProblem
    paths_m: Array

    def run(self, stop: StoppingRule) -> Solution | None:  # noqa: ARG002 - what it takes is short and bounded
        """Return the links."""
        problem, paths_m = self.area.whole(), self.paths_m
        if problem.n_uavs > len(paths_m):
            paths_m = np.concatenate([paths_m, problem.pinned_m[len(paths_m) :]])
        return linked(problem, paths_m)


def _with_rest(problem: Problem, sum_kbps: Array) -> Problem:
    """Return the problem with one link more, which carries `sum_kbps` (N,) whatever the others do."""
    shape = (problem.n_uavs + 1, problem.n_users + 1, problem.n_slots)
    khz = max(float(sum_kbps.max()) / EFFICIENCY, 1e-3)
    gain = np.zeros(shape)
    gain[:-1, :-1] = problem.snr_gain
    gain[-1, -1] = np.exp2(sum_kbps / khz) - 1.0  # at an altitude of 1 m, right overhead
    far = problem.low_m - FAR_M
    pinned = problem.pinned_m if problem.pinned_m.size else np.full((problem.n_uavs, problem.n_slots, 2), np.nan)
    return replace(
        problem,
        snr_gain=gain,
        start_m=_and(problem.start_m, far),
        user_m=_and(problem.user_m, far[None]),
        spread_m2=_and(problem.spread_m2, np.zeros(1)),
        step_m=_and(problem.step_m, 0.0),
        altitude_m=_and(problem.altitude_m, 1.0),
        bandwidth_hz=_and(problem.bandwidth_hz, khz * 1e3),
        past_kbps=_and(problem.past_kbps, np.full(problem.past_kbps.shape[1], np.nan)),
        n_flying=np.append(problem.n_flying, problem.n_slots),
        end_m=_and(problem.end_m, np.array([np.nan, np.nan])),
        min_kbps=_and(problem.min_kbps, 0.0),
        weight=_and(problem.weight, 1.0),
        demand_kbps=_and(problem.demand_kbps, np.inf),
        pinned_m=_and(pinned, np.broadcast_to(far, (problem.n_slots, 2))),
        air=None if problem.air is None else problem.air.and_one(),
    )


def _with_users(problem: Problem, decayed: float) -> Problem:
    """Return the problem with a past slot that has the others' sum of exp(mu rate) on the account of its first user."""
    slot = np.full((problem.n_users, 1), np.nan)
    slot[0] = np.log(max(decayed, 1e-300)) / problem.mu
    return replace(problem, past_kbps=np.hstack([problem.past_kbps, slot]))


def _and(array: NDArray[np.float64], more: Array | float) -> Array:
    return np.concatenate([array, np.asarray(more, dtype=float)[None]])
