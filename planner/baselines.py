"""The letter's baselines, through the interface of the other methods: same scenario, failures, constraints, summary.

`baseline1`: UAVs stay, each user is served by the nearest one, bands are shared equally. `baseline2`: UAVs fly to an
optimised placement and hover, nearest association, bandwidth for the greatest sum rate. `sr_max`: the whole
optimisation at mu = 0. `static`: UAVs stay, association and bandwidth are the best there are. A UAV that stays still
flies home in time when the scenario has an end position for it. After a failure each plans anew for the survivors.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner import fast
from skyfolio.planner.arrays import Array
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solution import Observer, Solution
from skyfolio.planner.stopping import StoppingRule

Indices = NDArray[np.intp]
STEPS_M = (80.0, 40.0, 20.0, 10.0, 5.0)
DIRECTIONS = np.array([(np.cos(angle), np.sin(angle)) for angle in np.arange(8) * np.pi / 4])


def baseline1(
    problem: Problem,
    stop: StoppingRule,  # noqa: ARG001 - there is nothing to iterate
    start_m: Array | None,  # noqa: ARG001 - UAVs stay where they are
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Serve each user by the nearest UAV with equal bandwidth, without flight; minimum rates are ignored."""
    paths = fast.flyable(problem)
    serving = nearest_uav(problem, paths)
    mine = (serving == np.arange(problem.n_uavs)[:, None, None]) & problem.there
    share = problem.bandwidth_hz[:, None, None] * mine / np.maximum(mine.sum(axis=1, keepdims=True), 1)
    return _reported(problem, fast.as_asked(problem, Solution(paths, serving, share.sum(axis=0), [])), observer)


def baseline2(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None,  # noqa: ARG001 - the placement is searched from where UAVs are
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Find placement and bandwidth for the greatest sum rate under nearest association.

    The paper the letter cites for it is not followed line by line: here a pattern search moves one UAV at a time from
    the start positions, for the mean channel. UAVs fly to their places at D_max and hover there; on the way, too, each
    UAV gives its band to the best of its nearest users. One iteration is one length of step.
    """
    placement = problem.start_m.copy()
    solution = _placed(problem, placement)
    history: list[Iteration] = []
    for length in STEPS_M:
        if stop(history):
            break
        placement = _moved(problem, placement, length)
        candidate = _placed(problem, placement)
        if _utility(problem, candidate) >= _utility(problem, solution):
            solution = candidate
        history.append(_iteration(problem, solution, len(history) + 1))
        observer(history[-1], partial(replace, solution, history=list(history)))
    return replace(solution, history=history)


def baseline2_fixed(
    problem: Problem,
    stop: StoppingRule,  # noqa: ARG001 - there is nothing to iterate
    start_m: Array | None,  # noqa: ARG001 - UAVs stay where they are
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Do as `baseline2`, read more narrowly: the start positions are the placement; only bandwidth is optimised."""
    return _reported(problem, _placed(problem, problem.start_m), observer)


def sr_max(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None,
    observer: Observer,
    *,
    n_starts: int | None,
    seed: int,
) -> Solution:
    """Run the letter's SR-Max: optimise everything for mu = 0. Its iterations show the mean sum rate."""
    return fast.optimise(replace(problem, mu=0.0), stop, start_m, observer, n_starts=n_starts, seed=seed)


def static(
    problem: Problem,
    stop: StoppingRule,  # noqa: ARG001
    start_m: Array | None,  # noqa: ARG001 - UAVs stay where they are
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001
    seed: int,  # noqa: ARG001
) -> Solution:
    """Find the best association and bandwidth for the problem's utility, without flight."""
    return _reported(problem, fast.linked(problem, fast.flyable(problem)), observer)


def nearest_uav(problem: Problem, paths_m: Array) -> Indices:
    """Return the UAV in flight that is nearest to each user: (K, N) indices. paths_m: (U, N, 2) metres."""
    distance2 = problem.distances2(paths_m)
    nearest: Indices = np.where(problem.flying[:, None], distance2, np.inf).argmin(axis=0)
    return nearest


def _placed(problem: Problem, placement_m: Array) -> Solution:
    """Fly to the placement (U, 2), hover, and serve the best of the nearest users in each slot."""
    paths = fast.flyable(problem, np.repeat(placement_m[:, None], problem.n_slots, axis=1))
    serving = nearest_uav(problem, paths)
    efficiency = np.take_along_axis(spectral_efficiency(problem, paths), serving[None], axis=0)[0] * problem.there
    bandwidth = np.zeros(serving.shape)
    for u in range(problem.n_uavs):
        mine = np.where(serving == u, efficiency, -1.0)
        best, slots = mine.argmax(axis=0), np.arange(problem.n_slots)
        bandwidth[best, slots] = np.where(mine[best, slots] > 0, problem.bandwidth_hz[u], bandwidth[best, slots])
    return fast.as_asked(problem, Solution(paths, serving, bandwidth, []))


def _moved(problem: Problem, placement_m: Array, length_m: float) -> Array:
    """Move one UAV after the other by `length_m` in the best direction, until none gains any more."""
    gain = problem.snr_gain.sum(axis=2) / problem.n_flying[:, None]  # (U, K)
    here, best = placement_m, _sum_rates(problem, gain, placement_m[None])[0]
    improved = True
    while improved:
        improved = False
        for u in range(problem.n_uavs):
            tried = np.repeat(here[None], len(DIRECTIONS), axis=0)
            tried[:, u] = np.clip(tried[:, u] + length_m * DIRECTIONS, problem.low_m, problem.high_m)
            rates = np.where(_apart(problem, tried, u), _sum_rates(problem, gain, tried), -np.inf)
            if rates.max() > best * (1 + 1e-6):
                here, best, improved = tried[rates.argmax()], rates.max(), True
    return here


def _apart(problem: Problem, placements_m: Array, u: int) -> NDArray[np.bool_]:
    """Return whether UAV u keeps `D_min` from the others in each of (C, U, 2) placements."""
    others = np.delete(placements_m, u, axis=1)
    near = np.linalg.norm(others - placements_m[:, u : u + 1], axis=2).min(axis=1, initial=np.inf)
    enough: NDArray[np.bool_] = near >= problem.separation_m
    return enough


def _sum_rates(problem: Problem, gain: Array, placements_m: Array) -> Array:
    """Return the sum rate of (C, U, 2) placements, each band for the best of its UAV's nearest users: (C,) bit/s."""
    apart = placements_m[:, :, None] - problem.mean_user_m
    distance2 = np.einsum("cukd,cukd->cuk", apart, apart) + problem.altitude_m[:, None] ** 2
    snr = gain / distance2
    if problem.bends is not None:
        snr = snr * np.moveaxis(problem.bends.at(np.moveaxis(np.einsum("cukd,cukd->cuk", apart, apart), 1, 0)), 0, 1)
    if problem.excess is not None:  # placements take the slots' place
        still = replace(problem.excess, reads=problem.excess.reads[:, :1])
        snr = snr * np.moveaxis(still.on_paths(np.moveaxis(placements_m, 1, 0)), 2, 0)
    mine = distance2 == distance2.min(axis=1, keepdims=True)
    efficiency = np.log2(1 + snr / (1 + np.maximum(snr.sum(axis=1, keepdims=True) - snr, 0.0)))
    best = np.where(mine, efficiency, 0.0).max(axis=2)
    rates: Array = (best * problem.bandwidth_hz).sum(axis=1)
    return rates


def _reported(problem: Problem, solution: Solution, observer: Observer) -> Solution:
    """Return the solution with its one iteration, after passing it to the observer."""
    only = _iteration(problem, solution, 1)
    reported = replace(solution, history=[only])
    observer(only, lambda: reported)
    return reported


def _iteration(problem: Problem, solution: Solution, number: int) -> Iteration:
    rates = fast.served_rates_bps(problem, solution)
    return Iteration(
        iteration=number,
        utility_bps=_utility(problem, solution) * 1e3,
        mean_sum_rate_bps=float(rates.sum(axis=0).mean()),
    )


def _utility(problem: Problem, solution: Solution) -> float:
    rates = fast.served_rates_bps(problem, solution) / 1e3
    return problem.utility_kbps(rates)
