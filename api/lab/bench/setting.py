"""What the sections of the planner's benchmark share: the stopping rule, the true utility, and a loss half-way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from skyfolio.planner import AnyOf, MaxIterations, Plan, RelativeGain, replan
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import served_rates_bps
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.remainder import remaining
from skyfolio.planner.solution import Solution


def stop() -> AnyOf:
    """Return a new instance of the planner's default stopping rule."""
    return AnyOf(MaxIterations(50), RelativeGain(1e-4))


def value_kbps(problem: Problem, solution: Solution) -> float:
    """Return the true utility of a solution."""
    rates = served_rates_bps(problem, solution) / 1e3
    return problem.utility_kbps(rates)


@dataclass(frozen=True)
class Loss:
    """The last UAV of a plan is lost half-way: what is left to plan. warm_m: (U, N, 2), the rest of the old paths."""

    made: Plan
    at_slot: int
    problem: Problem
    warm_m: Array

    def replan(self, **options: Any) -> Plan:
        """Return the replan, as the product makes it."""
        return replan(self.made, failed=[self.made.scenario.uav_ids[-1]], at_slot=self.at_slot, **options)


def loss_half_way(made: Plan) -> Loss:
    """Return what a plan leaves to do when its last UAV is lost half-way."""
    scenario, half = made.scenario, made.scenario.slots // 2
    rest, past = remaining(made, [scenario.uav_ids[-1]], half)
    warm = np.array([made.trajectories_m[uav][half:] for uav in rest.uav_ids])
    return Loss(made, half, problem_of(rest, past), warm)
