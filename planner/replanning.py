"""Plans the rest of an operation after something changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skyfolio.planner.areas.size import is_large
from skyfolio.planner.carrying import Carried, carried
from skyfolio.planner.changes import Changes
from skyfolio.planner.corrections import CorrectionsDb, of_uavs
from skyfolio.planner.disruption import former_of
from skyfolio.planner.methods import AREAS, DEFAULT_METHOD
from skyfolio.planner.pinning import PinError
from skyfolio.planner.pins import Pins
from skyfolio.planner.plans import Cause, Plan
from skyfolio.planner.remainder import cause_of, places_changed_m, remaining, rest_of_paths_m
from skyfolio.planner.solve import plan


def replan(
    previous: Plan,
    *,
    failed: Sequence[str] = (),
    at_slot: int,
    positions_m: Mapping[str, tuple[float, float]] | None = None,
    altitudes_m: Mapping[str, float] | None = None,
    used_wh: Mapping[str, float] | None = None,
    achieved_rates_bps: Mapping[str, Sequence[float]] | None = None,
    changes: Changes | None = None,
    cause: Cause | None = None,
    pins: Pins | None = None,
    keep_pins: bool = False,
    disruption_weight: float = 0.0,
    in_force: Plan | None = None,
    corrections_db: CorrectionsDb | None = None,
    **options: Any,
) -> Plan:
    """Plan the remaining slots of `previous` for the UAVs and users that are left.

    failed: ids of the UAVs that are gone. at_slot: the first slot to plan, on the operation's slot grid.
    positions_m: where the survivors are when that slot begins, metres east/north (default: where the plan has them).
    altitudes_m: how high they are then, in the datum of the plan's altitudes (default: as planned). used_wh: what they
    have used of their batteries by then; less than the plan has proven does not count (default: that).
    achieved_rates_bps: what each user got in the slots before `at_slot` (default: what the plan promised).
    changes: what else is different, and failed UAVs too. pins: what the new plan is held to, by its own slots; a pinned
    UAV keeps to the rest of its path. keep_pins: whether pins of the previous plan hold too, as far as they can still
    be kept (`carrying.py`; the plan's `dropped_pins` says which cannot); otherwise they hold no longer.
    disruption_weight: kbit/s of utility that it must gain to let another UAV serve a user throughout, or to fly 100 m
    off the old paths (`disruption.py`). in_force: the plan that is being flown, by which changes are counted, where
    that is not `previous`: when a UAV returns to an operation whose first plan had it. corrections_db: by UAV and user,
    by how much each link is better than the channel model says (default: as the previous plan assumed); a fleet that is
    planned by areas is planned with one for each UAV, the median over its users.
    options: as for `plan`; the method is the previous plan's unless another is named. After `areas` it is the default
    one, which is `areas` as long as the fleet is large; then only areas around what is different are planned anew.
    Raises ReplanError as `remaining` does, and PinError for `pins`; the previous plan stays as it is.
    """
    changes, given = changes or Changes(), pins or Pins()
    if corrections_db is not None and is_large(previous.scenario):
        corrections_db = of_uavs(corrections_db, previous.scenario.user_ids)
    scenario, past = remaining(
        previous,
        failed,
        at_slot,
        positions_m,
        achieved_rates_bps,
        changes,
        corrections_db,
        altitudes_m=altitudes_m,
        used_wh=used_wh,
    )
    rest_m = rest_of_paths_m(previous, at_slot, changes)
    flown = in_force or previous
    kept_m = set(rest_m) & set(flown.trajectories_m)
    method = DEFAULT_METHOD if previous.method == AREAS else previous.method
    around_m = places_changed_m(previous, at_slot, failed, changes)
    warm = [rest_m.get(uav.id, [uav.start_m] * scenario.slots) for uav in scenario.uavs]

    def held_to(kept: Carried) -> Plan:
        return plan(
            scenario,
            past=past,
            warm_start_m=np.array(warm),
            pins=kept.pins,
            current_m=rest_m,
            former=former_of(flown, scenario, at_slot, kept_m, disruption_weight),
            cause=cause or cause_of(changes, failed),
            parent=previous.id,
            revision=previous.revision + 1,
            dropped_pins=kept.dropped,
            **{"method": method, "around_m": around_m, **options},
        )

    if not (keep_pins and previous.pins):
        return held_to(Carried(given))
    kept = carried(previous, scenario, at_slot, rest_m, lost={*failed, *changes.failed}, given=given)
    try:
        return held_to(kept)
    except PinError as error:  # the others find no way around these paths: a plan matters more than they do
        if kept.pins.pinned_uavs == given.pinned_uavs:
            raise
        return held_to(kept.without_paths(given, scenario.slots, str(error)))
