"""What the map and the fleet table draw: a scene that stays, and frames that move. Pure; metres east/north."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import atan2, degrees
from typing import Any

from skyfolio.api.dashboard.schedule import Slip, slip
from skyfolio.api.dashboard.views import Operation, Vehicle
from skyfolio.planner import Pins, Plan, Scenario
from skyfolio.planner.energy.outlook import Outlook
from skyfolio.planner.geometry import Point, point_at

Json = dict[str, Any]

PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
"""Okabe and Ito's colours, which colour-blind people can distinguish; every UAV is also named."""

WORTH_BPS = 100.0
"""A planned rate below this does not count as service."""
CUT_SHARE = 0.02
"""A user that gets less than this share of its planned rate is cut off."""


@dataclass(frozen=True, kw_only=True)
class Spot:
    """One UAV on the map; `lost` means that it no longer counts for the operation."""

    uav_id: str
    at_m: Point | None
    course_deg: float = 0.0
    vehicle: Vehicle | None = None
    lost: bool = False
    slip: Slip | None = None
    energy: Outlook | None = None


def scene(scenario: Scenario, plans: Sequence[tuple[str, Plan]] = (), **more: Any) -> Json:
    """Return what stays: area, zones, users, and each plan's paths in a style (`current`, `former` or `other`)."""
    rates = [rate for _, plan in plans for row in plan.user_rates_bps.values() for rate in row]
    return {
        "area": scenario.area_m,
        "origin": scenario.origin.model_dump(),
        "no_fly": [zone.model_dump() for zone in scenario.no_fly],
        "users": [(user.id, *user.position_m) for user in scenario.users],
        "user_tracks": user_tracks(scenario),
        "uavs": list(scenario.uav_ids),
        "d_min": scenario.min_separation_m,
        "rate_max": max([1e3, *rates]) if rates else None,
        "plans": [{"style": style, "paths": plan.trajectories_m} for style, plan in plans],
        "pinned": pinned_ids(plans[0][1].pins) if plans else [],
        "reserved": {},
        "tiles": None,
        **more,
    }


def ground_words(data: Json) -> list[str]:
    """Return between which heights the ground of a scenario as JSON lies, in words; nothing without terrain."""
    terrain = data.get("terrain")
    if not terrain:
        return []
    heights = [height for row in terrain["heights_m"] for height in row]
    return [f"ground {min(heights):.0f} to {max(heights):.0f} m above sea level"]


def sketch(data: Json, pins: Pins | None = None) -> tuple[Json, Json]:
    """Return scene and frame of a scenario as JSON, even of an invalid one: the operator must see what is wrong."""
    pins = pins or Pins()
    drawn = {
        "area": data["area_m"],
        "origin": data["origin"],
        "no_fly": data["no_fly"],
        "users": [(user["id"], *user["position_m"]) for user in data["users"]],
        "user_tracks": {user["id"]: track for user in data["users"] if (track := _sketched_track(user, data))},
        "uavs": [uav["id"] for uav in data["uavs"]],
        "d_min": data["min_separation_m"] or 0.0,
        "rate_max": None,
        "plans": [{"style": "current", "paths": {uav: path for uav, path in pins.paths_m.items() if len(path) > 1}}],
        "pinned": pinned_ids(pins),
        "reserved": {},
        "tiles": None,
    }
    spots = [Spot(uav_id=uav["id"], at_m=tuple(uav["start_m"])) for uav in data["uavs"]]
    return drawn, frame(spots, None, None, {}, live=False)


def _sketched_track(user: Json, data: Json) -> list[Point]:
    """Return the track that a user of a draft is given, or the line that its velocity says; else nothing."""
    (east, north), velocity_mps = user["position_m"], user.get("velocity_mps")
    if user.get("positions_m") or not velocity_mps:
        return list(user.get("positions_m") or ())
    seconds = ((data["slots"] or 1) - 1) * (data["slot_duration_s"] or 0.0)
    return [(east, north), (east + velocity_mps[0] * seconds, north + velocity_mps[1] * seconds)]


def user_tracks(scenario: Scenario) -> dict[str, list[Point]]:
    """Return where each user that moves is when each slot begins."""
    slot_s = scenario.slot_duration_s
    return {user.id: [user.place_m(n, slot_s) for n in range(scenario.slots)] for user in scenario.users if user.moves}


def whereabouts(scenario: Scenario, n: int) -> dict[str, tuple[float, float, float]]:
    """Return place and radius, metres, in slot n of each user that moves or may be elsewhere than at its place."""
    slot_s = scenario.slot_duration_s
    return {
        user.id: (*user.place_m(n, slot_s), user.radius_m(n, slot_s))
        for user in scenario.users
        if user.moves or user.radius_m(n, slot_s) > 0.0
    }


def absent(scenario: Scenario, n: int) -> list[str]:
    """Return the users that are not there in slot n: the map shows them pale."""
    return [user.id for user in scenario.users if not user.is_there(n)]


def asked(scenario: Scenario) -> dict[str, float]:
    """Return what users ask for, bit/s, of those that have a limit."""
    return {user.id: user.demand_bps for user in scenario.users if user.demand_bps is not None}


def pinned_ids(pins: Pins) -> list[str]:
    """Return the UAVs whose paths are pinned and the users that are pinned to a UAV: the map marks both."""
    return [*pins.pinned_uavs, *pins.associations]


def reserved(former: Plan, lost: Iterable[str], from_slot: int) -> dict[str, list[Point]]:
    """Return the air reserved for each lost UAV: the rest of its route, and its way home from there."""
    air = {}
    for uav in lost:
        if uav in former.trajectories_m:
            rest = former.trajectories_m[uav][max(from_slot - former.first_slot, 0) :]
            air[uav] = [*rest, former.scenario.uav(uav).start_m]
    return air


def frame(
    spots: Sequence[Spot],
    plan: Plan | None,
    slot: int | None,
    rates: Mapping[str, float | None],
    *,
    promise: Plan | None = None,
    **more: Any,
) -> Json:
    """Return what moves.

    Args:
        spots: The UAVs.
        plan: The plan in force, if there is one.
        slot: The current slot on the operation's grid.
        rates: Rates of the users of `plan` in bit/s, None where unknown.
        promise: The plan that users' rates are judged by, by default `plan`: a user far below it is cut off.
        more: Further fields of the frame.
    """
    known = {user: rates.get(user) for user in plan.scenario.user_ids} if plan else {}
    at = None if plan is None or slot is None else local_slot(plan, slot)
    return {
        "uavs": [_drawn(spot) for spot in spots],
        "links": links(plan, slot) if plan and slot is not None else [],
        "rates": known,
        "users": {} if plan is None or at is None else whereabouts(plan.scenario, at),
        "absent": [] if plan is None or at is None else absent(plan.scenario, at),
        "asked": asked(plan.scenario) if plan else {},
        "cut": cut_off(promise or plan, slot, known) if plan and slot is not None else [],
        "slot": slot,
        "live": True,
        **more,
    }


def local_slot(plan: Plan, slot: int) -> int:
    """Return the slot of the plan that a slot of the operation is, the nearest one if it has none."""
    return min(max(slot - plan.first_slot, 0), plan.scenario.slots - 1)


def links(plan: Plan, slot: int) -> list[tuple[str, str, float]]:
    """Return (user, UAV, bandwidth in Hz) of every link of that slot of the operation's grid."""
    n = local_slot(plan, slot)
    return [(user, row[n], plan.bandwidth_hz[user][n]) for user, row in plan.association.items() if row[n]]


def cut_off(plan: Plan, slot: int, rates: Mapping[str, float | None]) -> list[str]:
    """Return the users that get almost nothing of their planned rate in that slot; `rates` are in bit/s by user id."""
    n = local_slot(plan, slot)
    found = []
    for user, promised in plan.user_rates_bps.items():
        rate = rates.get(user)
        if rate is not None and promised[n] > WORTH_BPS and rate < CUT_SHARE * promised[n]:
            found.append(user)
    return found


def planned_frame(
    plan: Plan,
    slot: int,
    rates: Mapping[str, float | None] | None = None,
    lost_at_m: Mapping[str, Point] | None = None,
) -> Json:
    """Return the planned situation at the beginning of that slot; `lost_at_m` has the last positions of lost UAVs."""
    n = local_slot(plan, slot)
    spots = [Spot(uav_id=uav, at_m=path[n], course_deg=_course(path, n)) for uav, path in plan.trajectories_m.items()]
    spots += [Spot(uav_id=uav, at_m=at, lost=True) for uav, at in (lost_at_m or {}).items()]
    planned = {user: row[n] for user, row in plan.user_rates_bps.items()}
    return frame(spots, plan, slot, planned if rates is None else rates, live=False)


def rows(spots: Sequence[Spot], operation: Operation | None) -> list[Json]:
    """Return the rows of the fleet table, the most urgent first."""
    table = [_row(number, spot, operation) for number, spot in enumerate(spots)]
    return sorted(table, key=lambda row: ("alarm", "warn", "ok", "idle").index(row["level"]))


def recorded_row(number: int, uav_id: str, *, lost: bool, slip: Slip | None) -> Json:
    """Return a row of the fleet table from a recording, which has positions only."""
    state, level = ("LOST", "alarm") if lost else ("RECORDED", "ok")
    nothing = dict.fromkeys(("age", "battery", "alt", "item", "items", "quality", "cause", "energy"))
    colour = PALETTE[number % len(PALETTE)]
    known = {
        "id": uav_id,
        "state": state,
        "level": level,
        "lost": lost,
        "slip": None if slip is None else list(slip),
        "colour": colour,
        "link": "live",
    }
    return {**nothing, **known}


def slip_of(plan: Plan | None, uav: str, elapsed_s: float | None, at_m: Point | None) -> Slip | None:
    """Return how far a UAV is off its plan; None before it begins, after its end, and for UAVs outside it."""
    if plan is None or elapsed_s is None or at_m is None or uav not in plan.trajectories_m:
        return None
    slot_s = plan.scenario.slot_duration_s
    local = elapsed_s - plan.first_slot * slot_s
    if not 0 <= local <= plan.scenario.slots * slot_s:
        return None
    return slip(plan.trajectories_m[uav], slot_s, local, at_m)


def state_of(vehicle: Vehicle | None, *, lost: bool, flying: bool) -> tuple[str, str, str]:
    """Return (state, cause, level) as a ground station shows them; the level is ok, warn, alarm or idle."""
    silent = vehicle.silent_for_s if vehicle else None
    quiet = "" if silent is None else f"silent for {silent:.1f} s"
    if lost:
        heard = vehicle is not None and vehicle.link == "live"
        reported = vehicle.condition_cause if vehicle is not None and heard else None
        return "LOST", reported or quiet or "declared lost", "alarm"
    if vehicle is None or vehicle.mode is None:
        return "NOT HEARD", quiet, "warn"
    if vehicle.link == "lost":
        return "LOST", quiet, "alarm"
    if vehicle.link == "stale":
        return "STALE", quiet, "warn"
    if not vehicle.armed:
        return "ON GROUND", "disarmed", "idle"
    mode = vehicle.mode.upper()
    if flying and mode not in {"MISSION", "AUTO", "GUIDED", "TAKEOFF", "OFFBOARD", "LAND"}:
        return mode, "not flying the plan", "warn"
    return mode, "", "ok"


def _row(number: int, spot: Spot, operation: Operation | None) -> Json:
    vehicle = spot.vehicle
    flying = operation is not None and operation.state == "flying"
    state, cause, level = state_of(vehicle, lost=spot.lost, flying=flying)
    drawn = _drawn(spot)
    return {
        **{name: drawn[name] for name in ("id", "age", "battery", "alt", "item", "link", "lost")},
        "state": state,
        "cause": cause,
        "level": level,
        "items": vehicle.mission_items if vehicle else None,
        "slip": None if spot.slip is None else list(spot.slip),
        "quality": vehicle.link_quality if vehicle else None,
        "energy": None if spot.energy is None else [spot.energy.used_wh, spot.energy.margin_wh],
        "colour": PALETTE[number % len(PALETTE)],
    }


def _drawn(spot: Spot) -> Json:
    vehicle = spot.vehicle
    state, _, _ = state_of(vehicle, lost=spot.lost, flying=False) if vehicle else ("", "", "")
    return {
        "id": spot.uav_id,
        "e": None if spot.at_m is None else round(spot.at_m[0], 2),
        "n": None if spot.at_m is None else round(spot.at_m[1], 2),
        "heading": round(spot.course_deg, 1),
        "alt": vehicle.relative_alt_m if vehicle else None,
        "age": vehicle.silent_for_s if vehicle else None,
        "battery": vehicle.battery_percent if vehicle else None,
        "item": vehicle.mission_item if vehicle else None,
        "link": vehicle.link if vehicle else "live",
        "lost": spot.lost,
        "state": state,
    }


def _course(path: Sequence[Point], n: int) -> float:
    here, ahead = point_at(path, n), point_at(path, n + 1)
    return degrees(atan2(ahead[0] - here[0], ahead[1] - here[1])) % 360 if here != ahead else 0.0
