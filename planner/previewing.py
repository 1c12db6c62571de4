"""A changed scenario compared with a plan: solved, set side by side, and forgotten."""

from __future__ import annotations

from typing import Any

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.carrying import carried
from skyfolio.planner.comparison import Comparison, compare
from skyfolio.planner.pins import Pins
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import Past
from skyfolio.planner.replanning import replan
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solve import plan


def preview(
    previous: Plan, *, scenario: Scenario | None = None, pins: Pins | None = None, **options: Any
) -> Comparison:
    """Plan what is different, and compare it with `previous`.

    scenario: instead of the plan's, from its slot 0 on; the search begins at the plan's paths as far as they can be
    flown, what users had before counts, and the plan's pins hold as far as they can be kept, beside `pins`: without
    them the comparison would show what the pins cost, not what the change does. Without a scenario, options are those
    of `replan`, `at_slot` and `changes` among them, and only the slots from there on are compared. Other options: as
    for `plan`. Raises ReplanError, UnreachableEndError and ValueError as those do.
    """
    if scenario is None:
        return compare(previous, replan(previous, pins=pins, **options))
    paths_m = _paths_of(previous, scenario)
    current_m = {uav: [(e, n) for e, n in path] for uav, path in zip(scenario.uav_ids, paths_m.tolist(), strict=True)}
    kept = carried(previous, scenario, previous.first_slot, current_m, given=pins)
    made = plan(
        scenario,
        past=_past_of(previous, scenario),
        warm_start_m=paths_m,
        pins=kept.pins,
        current_m=current_m,
        dropped_pins=kept.dropped,
        parent=previous.id,
        **options,
    )
    return compare(previous, made)


def _past_of(previous: Plan, scenario: Scenario) -> Past:
    """Return what the scenario's users had before the plan, NaN before a user was there."""
    rows = [previous.achieved_rates_bps.get(user, []) for user in scenario.user_ids]
    table = np.full((len(rows), max(len(row) for row in previous.achieved_rates_bps.values())), np.nan)
    for to, row in zip(table, rows, strict=True):
        to[len(to) - len(row) :] = row
    return Past(first_slot=previous.first_slot, rates_bps=table)


def _paths_of(previous: Plan, scenario: Scenario) -> Array:
    """Return (U, N, 2) metres: the plan's paths, cut or hovering on to the scenario's length; new UAVs hover."""
    slots = np.minimum(np.arange(scenario.slots), previous.scenario.slots - 1)
    still = {uav.id: np.array([uav.start_m] * previous.scenario.slots) for uav in scenario.uavs}
    known = {uav: np.array(path) for uav, path in previous.trajectories_m.items()}
    return np.stack([known.get(uav, still[uav])[slots] for uav in scenario.uav_ids])
