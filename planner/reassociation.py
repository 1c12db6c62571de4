"""After a loss, before any UAV has moved: who serves the lost UAV's users, from where the survivors are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.corrections import CorrectionsDb
from skyfolio.planner.emit import emit
from skyfolio.planner.fast import as_asked, linked
from skyfolio.planner.ground.ground import ground_of
from skyfolio.planner.ground.links import seen_aloft
from skyfolio.planner.pinning import caught_up_m
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.remainder import remaining, rest_of_paths_m
from skyfolio.planner.scenario import Point, Scenario

LEAST_BPS = 500.0
"""What a user of a lost UAV gets at least until there is a new plan: it can still be reached."""


def reassociate(
    previous: Plan,
    *,
    failed: Sequence[str] = (),
    at_slot: int,
    positions_m: Mapping[str, Point] | None = None,
    achieved_rates_bps: Mapping[str, Sequence[float]] | None = None,
    corrections_db: CorrectionsDb | None = None,
    **identity: Any,
) -> Plan:
    """Return the rest of `previous` with the best association and bandwidth on its own paths, which no UAV leaves.

    Exact for `sum` without minimum rates, as `fast.linked` is; no pins of associations are kept. failed, at_slot,
    achieved_rates_bps, corrections_db: as for `replan`. positions_m: where survivors are, metres east/north, from where
    they catch up with their paths (default: where the plan has them); whom they serve is decided by that, while the
    plan's own rates are those on its paths. Users that a failed UAV serves get at least LEAST_BPS where that can be
    had, whatever the utility. identity: `id`, `cause` and `solve_ms` of the plan. Raises ReplanError as `remaining`
    does.
    """
    scenario, past = remaining(
        previous, failed, at_slot, achieved_rates_bps=achieved_rates_bps, corrections_db=corrections_db
    )
    problem = problem_of(scenario, past)
    rest_m = rest_of_paths_m(previous, at_slot)
    planned_m = np.array([rest_m[uav] for uav in scenario.uav_ids], dtype=float)
    least_kbps = np.maximum(problem.min_kbps, _left_behind(previous, failed, at_slot, scenario) * LEAST_BPS / 1e3)
    flown_m = _flown_m(scenario, planned_m, positions_m or {})
    ground, altitudes_m = ground_of(scenario), _altitudes_m(previous, at_slot, scenario)

    def seen(paths_m: Array) -> Problem:
        if ground is None or altitudes_m is None:
            return problem
        return seen_aloft(problem, ground, paths_m, altitudes_m)

    links = linked(replace(seen(flown_m), min_kbps=least_kbps), flown_m)
    kept = as_asked(seen(planned_m), replace(links, paths_m=planned_m, altitudes_m=altitudes_m))
    told: dict[str, Any] = {"parent": previous.id, "revision": previous.revision + 1, "method": previous.method}
    return emit(scenario, past, problem, kept, ["reassociate"], ground=ground, **{**told, **identity})


def _altitudes_m(previous: Plan, at_slot: int, scenario: Scenario) -> Array | None:
    """Return the altitudes that the plan has for the rest of the paths: (U, N) metres; None where it has none."""
    if previous.altitudes_m is None:
        return None
    return np.array([previous.altitudes_m[uav][at_slot - previous.first_slot :] for uav in scenario.uav_ids])


def _left_behind(previous: Plan, failed: Sequence[str], at_slot: int, scenario: Scenario) -> NDArray[np.bool_]:
    """Return which users of the scenario a failed UAV would have given bandwidth in this slot: (K,)."""
    n = at_slot - previous.first_slot
    return np.array(
        [previous.association[user][n] in failed and previous.bandwidth_hz[user][n] > 0.0 for user in scenario.user_ids]
    )


def _flown_m(scenario: Scenario, planned_m: Array, positions_m: Mapping[str, Point]) -> Array:
    """Return where UAVs will be when slots begin if each goes from where it is onto its path: (U, N, 2) metres."""
    flown_m = planned_m.copy()
    for row, uav in zip(flown_m, scenario.uavs, strict=True):
        if uav.id in positions_m:
            here = uav.model_copy(update={"start_m": positions_m[uav.id]})
            row[:] = caught_up_m(scenario, here, row.tolist())
    return flown_m
