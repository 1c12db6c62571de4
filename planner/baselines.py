"""The schemes the letter compares with, under the same interface, scenario and failure handling as the planner.

They leave ends, no-fly zones and separation to `fast.flyable`, so that what they emit can be flown; least rates they
do not know. A replan uses the same scheme again: Baseline 2 places the survivors anew.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planner import fast
from planner.channel import spectral_efficiency, squared_distances
from planner.plans import Iteration
from planner.problem import Problem
from planner.solution import Observer, Solution
from planner.stopping import StoppingRule
from planner.utility import utility_kbps

Array = NDArray[np.float64]
Serving = NDArray[np.intp]
GRID = 9
"""Placements are sought on a grid of this many points a side and above the users nearest to each UAV."""
USERS_NEAR = 20


def sr_max(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None,
    observer: Observer,
    *,
    n_starts: int | None,
    seed: int,
) -> Solution:
    """SR-Max of the letter: the planner with beta = 0, whatever the scenario's mu."""
    greedy = replace(problem, mu=0.0, kind="sum")
    return fast.optimise(greedy, stop, start_m, observer, n_starts=n_starts, seed=seed)


def static(
    problem: Problem,
    stop: StoppingRule,  # noqa: ARG001 - one pass
    start_m: Array | None,  # noqa: ARG001 - nobody moves
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Everyone hovers at the start; association and bandwidth are the planner's best there."""
    paths = fast.flyable(problem)
    serving, bandwidth = fast.linked(problem, paths)
    return _told(problem, paths, serving, bandwidth, observer)


def baseline1(
    problem: Problem,
    stop: StoppingRule,  # noqa: ARG001 - one pass
    start_m: Array | None,  # noqa: ARG001 - nobody moves
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Baseline 1 of the letter: hover at the start, nearest UAV, its band split equally among its users."""
    paths = fast.flyable(problem)
    serving = _nearest(problem, paths)
    users_of = (serving[None] == np.arange(problem.n_uavs)[:, None, None]).sum(axis=1)  # (U, N)
    share = problem.bandwidth_hz[:, None] / np.maximum(users_of, 1)
    return _told(problem, paths, serving, share[serving, np.arange(problem.n_slots)], observer)


def baseline2(
    problem: Problem,
    stop: StoppingRule,  # noqa: ARG001 - the search ends by itself
    start_m: Array | None,  # noqa: ARG001 - it begins at the start positions
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Baseline 2 of the letter: placement and bandwidth for the sum rate, each user at its nearest UAV.

    Each UAV flies straight to its place at full speed and hovers there. The letter says no more of it, and its source
    was not at hand.
    """
    places = _placed(problem)
    paths = fast.flyable(problem, _straight(problem, places))
    serving = _nearest(problem, paths)
    rates = _served(spectral_efficiency(problem, paths), serving) * problem.bandwidth_hz[serving]
    best = np.zeros_like(rates)
    slots = np.arange(problem.n_slots)
    for u in range(problem.n_uavs):
        mine = np.where(serving == u, rates, -1.0)
        user = mine.argmax(axis=0)
        best[user, slots] += np.where(mine[user, slots] > 0, problem.bandwidth_hz[u], 0.0)
    return _told(problem, paths, serving, best, observer)


def _told(problem: Problem, paths: Array, serving: Serving, bandwidth_hz: Array, observer: Observer) -> Solution:
    """The solution of a scheme that does not iterate, with its one line of history."""
    rates = bandwidth_hz * _served(spectral_efficiency(problem, paths), serving) / 1e3
    utility = utility_kbps(problem.counted_kbps(rates), problem.kind, problem.mu)
    only = Iteration(iteration=1, utility_bps=utility * 1e3, mean_sum_rate_bps=float(rates.sum(axis=0).mean()) * 1e3)
    observer(only)
    return Solution(paths, serving, bandwidth_hz, [only])


def _served(efficiency: Array, serving: Serving) -> Array:
    """Of (U, K, N), what each user has of the UAV that serves it: (K, N)."""
    served: Array = np.take_along_axis(efficiency, serving[None], axis=0)[0]
    return served


def _nearest(problem: Problem, paths: Array) -> Serving:
    """The nearest UAV that still flies, for each user and slot: (K, N)."""
    away2 = squared_distances(paths, problem.user_m, problem.altitude_m)
    gone = np.arange(problem.n_slots) >= problem.n_flying[:, None]
    nearest: Serving = np.where(gone[:, None, :], np.inf, away2).argmin(axis=0)
    return nearest


def _straight(problem: Problem, places: Array) -> Array:
    """Paths straight to `places` (U, 2) at full speed: (U, N, 2) metres."""
    way = places - problem.start_m
    length = np.linalg.norm(way, axis=1)
    flown = np.minimum(problem.step_m[:, None] * np.arange(problem.n_slots), length[:, None])
    share = flown / np.where(length > 0, length, 1.0)[:, None]
    paths: Array = problem.start_m[:, None] + share[:, :, None] * way[:, None]
    return paths


def _placed(problem: Problem) -> Array:
    """Places within reach for the greatest sum rate at mean gains, one UAV after the other until none moves: (U, 2)."""
    gain = problem.snr_gain.mean(axis=2)
    places = problem.start_m.copy()
    best = _sum_rate(problem, gain, places)
    for _ in range(10):
        before = best
        for u in range(problem.n_uavs):
            for candidate in _candidates(problem, u):
                trial = places.copy()
                trial[u] = candidate
                if _apart(problem, trial, u) and (rate := _sum_rate(problem, gain, trial)) > best:
                    places, best = trial, rate
        if best <= before * (1 + 1e-9):
            break
    return places


def _candidates(problem: Problem, u: int) -> Array:
    """(C, 2) places that UAV u can reach half way through: a grid of the area, and above the users nearest to it."""
    axes = [np.linspace(problem.low_m[i], problem.high_m[i], GRID) for i in range(2)]
    away = np.linalg.norm(problem.user_m - problem.start_m[u], axis=1)
    users = np.clip(problem.user_m[np.argsort(away, kind="stable")[:USERS_NEAR]], problem.low_m, problem.high_m)
    points = np.vstack([users, np.array(list(product(*axes)))])
    reach = problem.step_m[u] * (problem.n_slots - 1) / 2
    within: Array = points[np.linalg.norm(points - problem.start_m[u], axis=1) <= reach]
    return within


def _apart(problem: Problem, places: Array, u: int) -> bool:
    others = np.delete(places, u, axis=0)
    return bool((np.linalg.norm(others - places[u], axis=1) >= problem.separation_m).all())


def _sum_rate(problem: Problem, gain: Array, places: Array) -> float:
    """The sum rate when all hover at `places` and each gives its band to the best of the users nearest to it."""
    away = places[:, None] - problem.user_m[None]
    away2 = (away**2).sum(axis=2) + problem.altitude_m[:, None] ** 2
    snr = gain / away2
    efficiency = np.log1p(snr / (1.0 + snr.sum(axis=0) - snr))
    mine = away2.argmin(axis=0)[None] == np.arange(problem.n_uavs)[:, None]
    return float((problem.bandwidth_hz * np.where(mine, efficiency, 0.0).max(axis=1)).sum())
