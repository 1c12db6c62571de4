"""Compile a plan into missions: choose the schedule and the writer, and check the limits of both."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from skyfolio.mavlink_bridge.altitudes import Altitudes, altitudes_of, ground_m
from skyfolio.mavlink_bridge.autopilots import DEFAULT_AUTOPILOT, Autopilot
from skyfolio.mavlink_bridge.errors import TooManyItems, UnknownUav
from skyfolio.mavlink_bridge.items import MAX_ITEMS, Mission
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.schedule import Schedule, airborne_schedule, ground_schedule
from skyfolio.mavlink_bridge.writer import OnEnd
from skyfolio.planner.geodesy import points_to_geodetic
from skyfolio.planner.plans import Plan


def compile_mission(
    plan: Plan,
    uav_id: str,
    *,
    airborne: bool = False,
    first_leg_s: float | None = None,
    on_end: OnEnd = OnEnd.LAND,
    autopilot: Autopilot = DEFAULT_AUTOPILOT,
    model: VehicleModel | None = None,
    max_items: int = MAX_ITEMS,
    altitudes: Altitudes | None = None,
) -> Mission:
    """Return the mission that flies `plan.trajectories_m[uav_id]` on a multirotor with this autopilot.

    On the ground: home (ArduPilot only), NAV_TAKEOFF at the slot-0 point, NAV_WAYPOINT at slot 0, then for every leg
    its DO_CHANGE_SPEED (left out where the speed stays) and the NAV_WAYPOINT it ends at; slots at one place become one
    waypoint with a hold, and slots that continue straight at one speed one leg. `airborne` is for a swap in flight: no
    take-off and no way back to slot 0; the first leg goes straight from where the vehicle is to the slot-1 point and
    has `first_leg_s` seconds (default: a whole slot). Altitudes are the plan's: above mean sea level over terrain,
    otherwise above each vehicle's own home; altitudes: others instead. `model`: how it flies (default: the autopilot
    with its default parameters). `max_items`: what it stores.

    Raises UnknownUav, UnknownAutopilot, TooManyItems, and ValueError for a `first_leg_s` that is not above 0 or not
    airborne.
    """
    profile = profile_of(autopilot)
    path_m = plan.trajectories_m.get(uav_id)
    if not path_m:
        raise UnknownUav(uav_id, plan.trajectories_m)
    scenario = plan.scenario
    uav = scenario.uav(uav_id)
    flown_m = path_m[: scenario.last_slot(uav) + 1]
    flown = altitudes or altitudes_of(plan, uav_id)
    levels_m = flown.metres[: len(flown_m)]
    timing = scenario.slot_duration_s, airborne, first_leg_s, model or profile.default_model
    schedule = _schedule(flown_m, levels_m, *timing)
    points_m = list({stop.point_m for stop in schedule.stops})
    places_deg = dict(zip(points_m, points_to_geodetic(scenario.origin, points_m), strict=True))
    writer = profile.writer(
        frame=flown.mission_frame,
        ground_m=ground_m(scenario, flown_m[-1]),
        to_geodetic=places_deg.__getitem__,
    )
    writer.write(schedule, takeoff=not airborne, on_end=on_end)
    if len(writer.items) > max_items:
        raise TooManyItems(uav_id, len(writer.items), max_items)
    return Mission(
        uav_id=uav_id,
        items=tuple(writer.items),
        slot_of_item=writer.slot_of_item,
        duration_s=schedule.duration_s,
        start_item=writer.start_item,
        autopilot=autopilot,
    )


def _schedule(
    path_m: list[tuple[float, float]],
    altitudes_m: Sequence[float],
    slot_s: float,
    airborne: bool,
    first_leg_s: float | None,
    model: VehicleModel,
) -> Schedule:
    if first_leg_s is None:
        first_leg_s = slot_s
    elif not airborne:
        raise ValueError(f"first_leg_s: {first_leg_s} is only for an airborne mission")
    if not (isfinite(first_leg_s) and first_leg_s > 0):
        raise ValueError(f"first_leg_s: {first_leg_s} must be a finite number of seconds above 0")
    if airborne:
        return airborne_schedule(path_m, slot_s, first_leg_s, model, altitudes_m)
    return ground_schedule(path_m, slot_s, model, altitudes_m)
