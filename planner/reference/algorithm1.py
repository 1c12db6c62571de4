"""Algorithm 1 of the letter: associate, allocate, steer, until done; then map the association to a binary one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.channel import spectral_efficiency
from planner.plans import Iteration
from planner.problem import Problem
from planner.reference.association import nearest_binary, relaxed_association
from planner.reference.bandwidth import best_bandwidth
from planner.reference.objective import SubproblemError
from planner.reference.trajectory import steered
from planner.repair import toward
from planner.solution import Observer, Solution, ignore
from planner.stopping import StoppingRule
from planner.utility import utility_kbps

Array = NDArray[np.float64]


def algorithm_1(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None = None,
    observer: Observer = ignore,
) -> Solution:
    """Alternate over A~, B and Q from feasible paths `start_m` (default: hover), keeping only what does not lower G.

    Every iterate is feasible for (6d)-(6g), so stopping at any time gives a flyable plan. The last line's binary
    mapping is followed by one more bandwidth step for the association that will really be used.
    """
    paths = problem.hover() if start_m is None else start_m
    efficiency = spectral_efficiency(problem, paths)
    association = np.full(efficiency.shape, 1.0 / problem.n_uavs)
    bandwidth = np.broadcast_to(
        problem.bandwidth_hz[:, None, None] * problem.n_uavs / problem.n_users, efficiency.shape
    ).copy()
    history: list[Iteration] = []
    while not stop(history):
        association = _or_keep(association, relaxed_association, problem, bandwidth, efficiency)
        bandwidth = _or_keep(bandwidth, best_bandwidth, problem, association, efficiency)
        paths = _steer(problem, association * bandwidth, paths)
        efficiency = spectral_efficiency(problem, paths)
        history.append(_iteration(problem, len(history) + 1, association * bandwidth * efficiency))
        observer(history[-1])

    serving = nearest_binary(association, efficiency)
    binary = np.moveaxis(np.eye(problem.n_uavs)[serving], 2, 0)
    final = _or_keep(np.zeros_like(binary), best_bandwidth, problem, binary, efficiency) * binary
    return Solution(paths, serving, final.sum(axis=0), history)


def _steer(problem: Problem, allocated_hz: Array, paths_m: Array) -> Array:
    """One SCA step, made exactly feasible, and refused when it would lower the true objective."""
    wanted = _or_keep(paths_m, steered, problem, allocated_hz, paths_m)
    candidate = toward(problem, paths_m, wanted)
    before = allocated_hz * spectral_efficiency(problem, paths_m)
    after = allocated_hz * spectral_efficiency(problem, candidate)
    return candidate if _utility(problem, after) >= _utility(problem, before) else paths_m


def _or_keep(last: Array, subproblem: Callable[..., Array], *given: Problem | Array) -> Array:
    """The subproblem's solution, or the last iterate where the interior point method found none."""
    try:
        return subproblem(*given)
    except SubproblemError:
        return last


def _utility(problem: Problem, pair_rates_bps: Array) -> float:
    return utility_kbps(problem.counted_kbps(pair_rates_bps.sum(axis=0) / 1e3), problem.kind, problem.mu)


def _iteration(problem: Problem, number: int, pair_rates_bps: Array) -> Iteration:
    return Iteration(
        iteration=number,
        utility_bps=_utility(problem, pair_rates_bps) * 1e3,
        mean_sum_rate_bps=float(pair_rates_bps.sum(axis=(0, 1)).mean()),
    )
