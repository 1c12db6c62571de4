"""How a UAV keeps out of air that is reserved for UAVs that were lost and may still fly: it flies higher."""

from __future__ import annotations

from collections.abc import Sequence

from skyfolio.mavlink_bridge.ghosts import Airspace
from skyfolio.planner import Plan
from skyfolio.planner.geometry import Point

GHOST_CLEARANCE_M = 5.0
"""A UAV that must cross the air of a ghost flies at least this much higher: heights are less certain than positions."""


def climb_above_ghosts(
    plan: Plan, uav: str, path_m: Sequence[Point], airspace: Airspace, now_s: float
) -> tuple[Plan, float, list[str]]:
    """Return the plan with this UAV raised if its path comes too close to a ghost's, by how much, and why.

    path_m: metres east/north of the scenario's origin, from where the UAV is `now_s` fleet seconds after slot 0 of the
    operation. The height is in metres, 0 where nothing is in the way. Only the altitude of `uav` changes.
    """
    scenario = plan.scenario
    airspace.expire(now_s)
    first_s = max((plan.first_slot + 1) * scenario.slot_duration_s, now_s + 0.1)
    times_s = [now_s, *(first_s + slot * scenario.slot_duration_s for slot in range(len(path_m) - 1))]
    conflicts = airspace.conflicts({uav: path_m}, times_s, scenario.min_separation_m)
    if not conflicts:
        return plan, 0.0, []
    higher_m = max(scenario.min_separation_m, GHOST_CLEARANCE_M)
    if plan.altitudes_m is not None:
        higher = [metres + higher_m for metres in plan.altitudes_m[uav]]
        raised = plan.model_copy(update={"altitudes_m": {**plan.altitudes_m, uav: higher}})
        return raised, higher_m, [str(conflict) for conflict in conflicts]
    uavs = tuple(
        other.model_copy(update={"altitude_m": scenario.altitude_of(other) + higher_m}) if other.id == uav else other
        for other in scenario.uavs
    )
    raised = plan.model_copy(update={"scenario": scenario.model_copy(update={"uavs": uavs})})
    return raised, higher_m, [str(conflict) for conflict in conflicts]
