"""One case of a sweep, planned and replanned after its loss: one row of the results."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from pydantic import ValidationError

from skyfolio.api.lab.sweep.settings import Case, case_of
from skyfolio.api.lab.sweep.spec import Base, Settings, SpecError
from skyfolio.planner import PinError, Plan, ReplanError, UnreachableEndError, plan, replan
from skyfolio.planner.arrays import Array
from skyfolio.planner.utility import jain_index

MEASURES = (
    "utility_bps",
    "upper_bound_bps",
    "gap",
    "mean_sum_rate_bps",
    "sum_rate_variance_kbps2",
    "jain",
    "least_user_rate_bps",
    "solve_ms",
    "replan_ms",
)
"""Utility, bound and gap are those of the last plan, which count what was achieved before the loss. The others are of
all slots of the operation: before the loss by the first plan, after it by the replan."""
NO_PLAN = (SpecError, ValidationError, ReplanError, PinError, UnreachableEndError)
"""A case that has no plan is a result, and its row says why; anything else is a defect, and breaks its batch."""


def row_of(base: Base, settings: Settings) -> dict[str, Any]:
    """Return the results of the case of these settings: `status`, `error`, MEASURES, `user_rates_bps`.

    status: that of the last plan, or `refused` where there is none. user_rates_bps: each user's mean rate.
    """
    try:
        return _measured(*_planned(case_of(base, settings)))
    except NO_PLAN as error:
        return {"status": "refused", "error": str(error)}


def _planned(case: Case) -> tuple[Plan, Plan | None]:
    """Return the plan, and the replan after the loss if there is one."""
    clock = time.perf_counter
    first = plan(case.scenario, method=case.method, n_starts=case.starts, seed=case.seed, clock=clock)
    if not case.failed:
        return first, None
    at_slot = case.scenario.slots // 2 if case.at_slot is None else case.at_slot
    return first, replan(first, failed=case.failed, at_slot=at_slot, n_starts=case.starts, seed=case.seed, clock=clock)


def _measured(first: Plan, second: Plan | None) -> dict[str, Any]:
    last = second or first
    rates_bps = _rates_bps(last)
    summary = last.summary
    total_kbps = rates_bps.sum(axis=0) / 1e3
    users = rates_bps.mean(axis=1)
    return {
        "status": last.status.value,
        "error": None,
        "utility_bps": summary.utility_bps,
        "upper_bound_bps": summary.upper_bound_bps,
        "gap": summary.gap,
        "mean_sum_rate_bps": float(total_kbps.mean()) * 1e3,
        "sum_rate_variance_kbps2": float(total_kbps.var()),
        "jain": jain_index(rates_bps / 1e3),
        "least_user_rate_bps": float(users.min()),
        "solve_ms": first.solve_ms,
        "replan_ms": None if second is None else second.solve_ms,
        "user_rates_bps": users.tolist(),
    }


def _rates_bps(plan: Plan) -> Array:
    """Return each user's rate in each slot of the operation, (K, N) bit/s: as achieved, then as planned."""
    users = plan.scenario.user_ids
    return np.array([[*plan.achieved_rates_bps[user], *plan.user_rates_bps[user]] for user in users])
