"""Algorithm 1 of the letter: associate, allocate, steer, until done; then map the association to a binary one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.reference.association import nearest_binary, relaxed_association
from skyfolio.planner.reference.bandwidth import best_bandwidth, whole_shares
from skyfolio.planner.reference.objective import SubproblemError
from skyfolio.planner.reference.trajectory import steered
from skyfolio.planner.repair import toward
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solution import Observer, Solution, ignore
from skyfolio.planner.stopping import StoppingRule


def algorithm_1(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None = None,
    observer: Observer = ignore,
) -> Solution:
    """Alternate over A~, B and Q from feasible paths `start_m` (default: hover), without ever lowering G.

    Every iterate is feasible for (6d)-(6g), so stopping at any time gives a flyable plan. The last line's binary
    mapping is followed by one more bandwidth step for the resulting association.
    """
    now = _first(problem, problem.hover() if start_m is None else start_m)
    history: list[Iteration] = []
    while not stop(history):
        for subproblem in (_associated, _allocated, _steered):  # (a4), (a5), (a7)
            now = _improved(now, subproblem)
        history.append(now.iteration(len(history) + 1))
        observer(history[-1], partial(binary_solution, now, list(history)))
    return binary_solution(now, history)


@dataclass(frozen=True)
class Iterate:
    """A~, B and Q at one moment: association and bandwidth_hz (U, K, N), paths_m (U, N, 2)."""

    problem: Problem
    association: Array
    bandwidth_hz: Array
    paths_m: Array

    @cached_property
    def efficiency(self) -> Array:
        """The spectral efficiency log2(1 + SINR) of each pair: (U, K, N) bit/s/Hz."""
        return spectral_efficiency(self.problem, self.paths_m)

    @property
    def given(self) -> Array:
        """The bandwidth that each pair has, a b: (U, K, N) Hz."""
        return self.association * self.bandwidth_hz

    @cached_property
    def rates_kbps(self) -> Array:
        """The rates R_k[n] of eq. (3): (K, N)."""
        rates: Array = (self.given * self.efficiency).sum(axis=0) / 1e3
        return rates

    @cached_property
    def utility_kbps(self) -> float:
        """The objective G of these rates and the past."""
        return self.problem.utility_kbps(self.rates_kbps)

    @cached_property
    def shortfall_kbps(self) -> float:
        """The shortfall from the minimum rates, summed over users and slots."""
        missing = self.problem.min_kbps[:, None] * (1 - 1e-9) - self.rates_kbps
        return float(np.maximum(missing, 0.0).sum())

    def iteration(self, number: int) -> Iteration:
        """Return the iteration as it is passed to the observer."""
        return Iteration(
            iteration=number,
            utility_bps=self.utility_kbps * 1e3,
            mean_sum_rate_bps=float(self.rates_kbps.sum(axis=0).mean()) * 1e3,
        )


def _first(problem: Problem, paths_m: Array) -> Iterate:
    """Return the first iterate, in which all users share everything: line 2 of Algorithm 1."""
    shape = (problem.n_uavs, problem.n_users, problem.n_slots)
    there = problem.flying[:, None, :]
    association = np.broadcast_to(there / there.sum(axis=0), shape)
    bandwidth = np.broadcast_to(problem.bandwidth_hz[:, None, None] * there.sum(axis=0) / problem.n_users, shape)
    return Iterate(problem, association, bandwidth, paths_m)


def _associated(now: Iterate) -> Iterate:
    return replace(now, association=relaxed_association(now.problem, now.bandwidth_hz, now.efficiency))


def _allocated(now: Iterate) -> Iterate:
    return replace(now, bandwidth_hz=best_bandwidth(now.problem, now.association, now.efficiency))


def _steered(now: Iterate) -> Iterate:
    return replace(now, paths_m=toward(now.problem, now.paths_m, steered(now.problem, now.given, now.paths_m)))


def _improved(now: Iterate, subproblem: Callable[[Iterate], Iterate]) -> Iterate:
    """Return the iterate with the subproblem's solution, unless it is worse: by minimum rates, then by utility."""
    try:
        candidate = subproblem(now)
    except SubproblemError:
        return now
    if candidate.shortfall_kbps != now.shortfall_kbps:
        return candidate if candidate.shortfall_kbps < now.shortfall_kbps else now
    return candidate if candidate.utility_kbps >= now.utility_kbps else now


def binary_solution(now: Iterate, history: list[Iteration]) -> Solution:
    """Map the association to a binary one (line 9), and solve the bandwidth for it."""
    problem = now.problem
    serving = nearest_binary(problem, now.association, now.bandwidth_hz, now.efficiency)
    binary = np.moveaxis(np.eye(problem.n_uavs)[serving], 2, 0)
    rounded = replace(now, association=binary, bandwidth_hz=_kept_shares(now, binary))
    final = _improved(rounded, _allocated)
    return Solution(now.paths_m, serving, final.given.sum(axis=0), history)


def _kept_shares(now: Iterate, binary: Array) -> Array:
    """Return what users keep of the relaxed allocation, in full bands: (U, K, N) Hz; equal parts if it is nothing."""
    band = now.problem.bandwidth_hz[:, None, None]
    kept = whole_shares(now.given / band, binary)
    equal = binary / np.maximum(binary.sum(axis=1, keepdims=True), 1.0)
    shares: Array = band * np.where(kept.sum(axis=1, keepdims=True) > 0, kept, equal)
    return shares
