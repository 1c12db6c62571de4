"""The parts of the fast path, one at a time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import linked, optimise
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.reference.algorithm1 import algorithm_1
from skyfolio.planner.reference.objective import SubproblemError
from skyfolio.planner.reference.trajectory import steered
from skyfolio.planner.repair import toward
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solution import Solution
from skyfolio.planner.stopping import StoppingRule


def variants(problem: Problem, stop: Callable[[], StoppingRule], starts: int) -> dict[str, Callable[[], Solution]]:
    """Return each step from the letter's method to the product's, by name; each solves the problem once."""
    return {
        "paper alternation: (a4), (a5), (a7) in turn": lambda: algorithm_1(problem, stop()),
        "joint step: association and bandwidth at once, then (a7)": lambda: joint_step(problem, stop()),
        "single start: joint step, projected gradient": lambda: optimise(problem, stop(), n_starts=1),
        f"multi-start: the same from {starts} starts": lambda: optimise(problem, stop(), n_starts=starts),
    }


def joint_step(problem: Problem, stop: StoppingRule) -> Solution:
    """Run Algorithm 1 with the fast path's joint association and bandwidth in place of (a4) and (a5)."""
    now = linked(problem, problem.hover())
    history: list[Iteration] = []
    while not stop(history):
        given_hz = now.bandwidth_hz * (now.serving == np.arange(problem.n_uavs)[:, None, None])
        candidate = _steered(problem, given_hz, now)
        if _utility(problem, candidate) >= _utility(problem, now):
            now = candidate
        worth = _utility(problem, now) * 1e3
        history.append(Iteration(iteration=len(history) + 1, utility_bps=worth, mean_sum_rate_bps=worth))
    return now


def _steered(problem: Problem, given_hz: Array, now: Solution) -> Solution:
    """Return one step of (a7) and new links; unchanged where the interior point method finds nothing."""
    try:
        target_m = steered(problem, given_hz, now.paths_m)
    except SubproblemError:
        return now
    return linked(problem, toward(problem, now.paths_m, target_m))


def _utility(problem: Problem, solution: Solution) -> float:
    efficiency = spectral_efficiency(problem, solution.paths_m)
    served = np.take_along_axis(efficiency, solution.serving[None], axis=0)[0]
    rates = solution.bandwidth_hz * served / 1e3
    return problem.utility_kbps(rates)
