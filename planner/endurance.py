"""Batteries in a replan: what has been used by then, and until which slot each UAV can stay."""

from __future__ import annotations

from collections.abc import Mapping
from math import nan

import numpy as np

from skyfolio.planner.energy.rules import stays
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Point, Scenario, Uav


def proven_use_wh(previous: Plan, uav: Uav, begin: int) -> float | None:
    """Return what the UAV has used at most when slot `begin` of the plan begins, Wh; None while it is on the ground.

    It is what the plan has proven: with it the rest of the plan is still affordable.
    """
    battery, air = uav.battery, previous.scenario.air_of(uav)
    if battery is None or air is None or begin == 0 or uav.id not in previous.energy_margin_wh:
        return None if battery is None else battery.used_wh
    place_m = np.array([[previous.trajectories_m[uav.id][begin]]], dtype=float)
    altitude_m = None if previous.altitudes_m is None else np.array([[previous.altitudes_m[uav.id][begin]]])
    left = previous.energy_margin_wh[uav.id][begin - 1] + float(air.home_wh(place_m, altitude_m)[0, 0])
    return max(0.0, battery.budget_wh - left)


def proven_by_wh(plan: Plan, uav_id: str, slots: float) -> float | None:
    """Return what a UAV has used at most `slots` slot durations after its plan began, Wh; None where it is not known.

    It is not for UAVs without a battery or that are not in the plan, nor before they have flown for a slot.
    """
    if uav_id not in plan.energy_margin_wh:
        return None
    uav, last = plan.scenario.uav(uav_id), plan.scenario.slots - 1
    at = min(max(slots, 1.0 if uav.battery is None or uav.battery.used_wh is None else 0.0), float(last))
    low = min(int(at), last - 1) if last else 0
    here, there = (proven_use_wh(plan, uav, slot) for slot in (low, min(low + 1, last)))
    if here is None:
        return there
    return here if there is None else here + (at - low) * (there - here)


def in_the_air(uav: Uav, *, home_m: Point, used_wh: float | None) -> Uav:
    """Return the UAV with so much used of its battery, and the home that it started from."""
    assert uav.battery is not None  # noqa: S101 - the caller has looked
    return uav.model_copy(update={"home_m": home_m, "battery": uav.battery.model_copy(update={"used_wh": used_wh})})


def for_one_slot(scenario: Scenario, uavs: tuple[Uav, ...], proven_wh: Mapping[str, float | None]) -> tuple[Uav, ...]:
    """Return the UAVs, those whose measured energy does not even last for one slot with just enough for it.

    Such a UAV is planned to go home after that slot, as soon as any plan can have it; refused, it would leave the
    others without a plan. What is proven to be used, Wh by id, is not doubted.
    """
    air = scenario.air_for(uavs)
    if air is None or not air.has_energy or not uavs:
        return uavs
    starts = np.array([uav.start_m for uav in uavs], dtype=float)
    lacks_wh = {stay.uav: stay.lacks_wh for stay in stays(air, starts, starts, [0] * len(uavs))}
    return tuple(
        _with_less_used(uav, lacks_wh[u], proven_wh[uav.id] or 0.0) if u in lacks_wh and uav.id in proven_wh else uav
        for u, uav in enumerate(uavs)
    )


def _with_less_used(uav: Uav, less_wh: float, least_wh: float) -> Uav:
    battery = uav.battery
    if battery is None or battery.used_wh is None:
        return uav
    used_wh = max(least_wh, battery.used_wh - less_wh)
    return uav.model_copy(update={"battery": battery.model_copy(update={"used_wh": used_wh})})


def while_energy_lasts(scenario: Scenario, uavs: tuple[Uav, ...], slots: int) -> tuple[Uav, ...]:
    """Return the UAVs of a replan of so many slots, those whose energy ends before leaving as late as they can.

    One that has an end position, or cannot stay for a single slot, is left as it is: the scenario refuses it by name.
    """
    air = scenario.air_for(uavs)
    if air is None or not air.has_energy or not uavs:
        return uavs
    starts = np.array([uav.start_m for uav in uavs], dtype=float)
    ends = np.array([uav.end_m or (nan, nan) for uav in uavs], dtype=float)
    last = [min(uav.leaves_at_slot or slots, slots) - 1 for uav in uavs]
    until = {
        stay.uav: stay.slots for stay in stays(air, starts, ends, last) if stay.slots and uavs[stay.uav].end_m is None
    }
    return tuple(
        uav.model_copy(update={"leaves_at_slot": until[u]}) if u in until else uav for u, uav in enumerate(uavs)
    )
