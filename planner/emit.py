"""From arrays to a `Plan`: ids, measures, certificate, and the feasibility check that every plan must pass."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from typing import Any

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import upper_bound_kbps
from skyfolio.planner.energy.account import account_of
from skyfolio.planner.fast import served_rates_bps
from skyfolio.planner.feasibility import MIN_RATE_ROUNDING, require_feasible
from skyfolio.planner.ground.bounding import bound_over_kbps
from skyfolio.planner.ground.ground import Ground
from skyfolio.planner.ground.links import seen_aloft
from skyfolio.planner.plans import Plan, PlanStatus, Summary
from skyfolio.planner.problem import Past, Problem
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solution import Solution
from skyfolio.planner.utility import jain_index, mean_variance_kbps


def emit(
    scenario: Scenario,
    past: Past,
    problem: Problem,
    solution: Solution,
    inputs: Sequence[object] = (),
    *,
    ground: Ground | None = None,
    **identity: Any,
) -> Plan:
    """Return the solution by ids, with summary and certificate. Raises InfeasiblePlanError, which means a defect.

    inputs: what distinguishes this plan beside the scenario and its past; it enters the default id. ground: over which
    the solution has altitudes.
    """
    bound_kbps = None
    if ground is not None and solution.altitudes_m is not None:
        bound_kbps = bound_over_kbps(problem, ground)
        problem = seen_aloft(problem, ground, solution.paths_m, solution.altitudes_m)
        identity["altitudes_m"] = _by_id(scenario.uav_ids, solution.altitudes_m)
    rates_bps = served_rates_bps(problem, solution)
    unmet = unmet_min_rates(scenario, rates_bps)
    if unmet:
        identity["status"] = PlanStatus.INFEASIBLE
    identity.setdefault("id", _digest(scenario, past, inputs))
    uav_ids = np.array(scenario.uav_ids, dtype=object)
    emitted = Plan(
        first_slot=past.first_slot,
        scenario=scenario,
        trajectories_m={
            uav: [(e, n) for e, n in path]
            for uav, path in zip(scenario.uav_ids, solution.paths_m.tolist(), strict=True)
        },
        association=dict(zip(scenario.user_ids, uav_ids[solution.serving].tolist(), strict=True)),
        bandwidth_hz=_by_id(scenario.user_ids, solution.bandwidth_hz),
        user_rates_bps=_by_id(scenario.user_ids, rates_bps),
        achieved_rates_bps=_achieved(scenario, past),
        summary=summarise(problem, rates_bps / 1e3, bound_kbps),
        history=solution.history,
        unmet_min_rate_slots=unmet,
        **_energy(scenario, problem, solution),
        **identity,
    )
    return require_feasible(emitted)


def _energy(scenario: Scenario, problem: Problem, solution: Solution) -> dict[str, dict[str, list[float]]]:
    """Return the energy of the plan by field and UAV, of those with a battery."""
    if problem.air is None or not problem.air.has_energy:
        return {}
    account = account_of(problem.air, solution.paths_m, problem.n_flying, solution.altitudes_m)
    tables = {"energy_wh": account.used_wh, "energy_margin_wh": account.margin_wh}
    with_battery = [u for u, uav in enumerate(scenario.uavs) if uav.battery is not None]
    return {field: {scenario.uav_ids[u]: table[u].tolist() for u in with_battery} for field, table in tables.items()}


def _by_id(ids: Sequence[str], table: Array) -> dict[str, list[float]]:
    return dict(zip(ids, table.tolist(), strict=True))


def _achieved(scenario: Scenario, past: Past) -> dict[str, list[float]]:
    """Return by user the rates in the past slots in which it was there."""
    if not past.rates_bps.size:
        return {user: [] for user in scenario.user_ids}
    return {user: row[np.isfinite(row)].tolist() for user, row in zip(scenario.user_ids, past.rates_bps, strict=True)}


def unmet_min_rates(scenario: Scenario, rates_bps: Array) -> dict[str, list[int]]:
    """Return by user the slots in which it gets less than its `min_rate_bps`; rates_bps: (K, N)."""
    short = {
        user.id: [
            n for n in np.flatnonzero(row < user.min_rate_bps * (1 - MIN_RATE_ROUNDING)).tolist() if user.is_there(n)
        ]
        for user, row in zip(scenario.users, rates_bps, strict=True)
        if user.min_rate_bps > 0
    }
    return {user: slots for user, slots in short.items() if slots}


def summarise(problem: Problem, rates_kbps: Array, bound_kbps: float | None = None) -> Summary:
    """Return the measures of a (K, N) rate table; utility and bound include the past, the others only planned slots.

    bound_kbps: an upper bound of the utility, if it is not to be found here.
    """
    utility = problem.utility_kbps(rates_kbps)
    bound = max(upper_bound_kbps(problem, rates_kbps) if bound_kbps is None else bound_kbps, utility)
    per_slot = rates_kbps.sum(axis=0)
    return Summary(
        utility_bps=utility * 1e3,
        mean_sum_rate_bps=float(per_slot.mean()) * 1e3,
        sum_rate_variance_kbps2=float(per_slot.var()),
        mean_variance_eq5_bps=mean_variance_kbps(rates_kbps, problem.mu, problem.there, problem.weight) * 1e3,
        jain=jain_index(rates_kbps, problem.there),
        upper_bound_bps=bound * 1e3,
        gap=(bound - utility) / max(abs(utility), 1e-9),
    )


def _digest(scenario: Scenario, past: Past, inputs: Sequence[object]) -> str:
    hashed = sha256(scenario.model_dump_json().encode())
    hashed.update(repr((past.first_slot, past.rates_bps.shape, *inputs)).encode())
    hashed.update(np.ascontiguousarray(past.rates_bps).tobytes())
    return "plan-" + hashed.hexdigest()[:12]
