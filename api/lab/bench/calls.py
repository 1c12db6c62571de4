"""Whole calls of `planner.plan` and `planner.replan` at their defaults, timed."""

from __future__ import annotations

from typing import Any

from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.measure import timed
from skyfolio.planner import Plan, Scenario, plan, replan


def timed_calls(scenario: Scenario, effort: Effort, share: float = 1.0) -> tuple[dict[str, Any], Plan]:
    """Return the times of a plan and of a replan after a loss half-way, what the plan is worth, and the plan.

    share: of the effort's budget of each timing.
    """
    budget_s = effort.budget_s * share
    call, made = timed(lambda: plan(scenario), runs=effort.runs, budget_s=budget_s)
    half, lost = scenario.slots // 2, scenario.uav_ids[-1]
    again, _ = timed(lambda: replan(made, failed=[lost], at_slot=half), runs=effort.runs, budget_s=budget_s)
    return {"plan_call": call, "replan_call": again, "utility_kbps": made.summary.utility_bps / 1e3}, made
