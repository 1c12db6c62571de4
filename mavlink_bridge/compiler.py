"""Plan -> mission: which schedule, whose items, and the limits both must keep."""

from __future__ import annotations

from math import isfinite

from mavlink_bridge.errors import TooManyItems, UnknownUav
from mavlink_bridge.geodesy import east_north_to_geodetic
from mavlink_bridge.items import MAX_ITEMS, Mission
from mavlink_bridge.pace import VehicleModel
from mavlink_bridge.px4 import OnEnd, Px4Writer
from mavlink_bridge.schedule import Schedule, airborne_schedule, ground_schedule
from planner.plans import Plan

_PX4 = VehicleModel()


def compile_mission(
    plan: Plan,
    uav_id: str,
    *,
    airborne: bool = False,
    first_leg_s: float | None = None,
    on_end: OnEnd = OnEnd.LAND,
    model: VehicleModel = _PX4,
) -> Mission:
    """The mission that flies `plan.trajectories_m[uav_id]` on a PX4 multirotor.

    On the ground: NAV_TAKEOFF at the slot-0 point (item 0), NAV_WAYPOINT at slot 0 (item 1), then for every leg its
    DO_CHANGE_SPEED (left out where the speed stays) and the NAV_WAYPOINT it ends at; slots at one place become one
    waypoint with a hold. `airborne` is for a swap in flight: no take-off and no way back to slot 0; the first leg goes
    straight from where the vehicle is to the slot-1 point and has `first_leg_s` seconds (default: a whole slot).
    Altitudes are metres above each vehicle's own home.

    Raises UnknownUav, TooManyItems (over 200), ValueError for a `first_leg_s` that is not above 0 or not airborne.
    """
    path_m = plan.trajectories_m.get(uav_id)
    if not path_m:
        raise UnknownUav(uav_id, plan.trajectories_m)
    scenario = plan.scenario
    uav = scenario.uav(uav_id)
    schedule = _schedule(path_m[: scenario.last_slot(uav) + 1], scenario.slot_duration_s, airborne, first_leg_s, model)
    writer = Px4Writer(
        altitude_m=scenario.altitude_of(uav),
        to_geodetic=lambda point: east_north_to_geodetic(scenario.origin, *point),
    )
    writer.write(schedule, takeoff=not airborne, on_end=on_end)
    if len(writer.items) > MAX_ITEMS:
        raise TooManyItems(uav_id, len(writer.items), MAX_ITEMS)
    return Mission(
        uav_id=uav_id,
        items=tuple(writer.items),
        slot_of_item=writer.slot_of_item,
        duration_s=schedule.duration_s,
    )


def _schedule(
    path_m: list[tuple[float, float]],
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
        return airborne_schedule(path_m, slot_s, first_leg_s, model)
    return ground_schedule(path_m, slot_s, model)
