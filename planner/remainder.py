"""What is left of an operation after something changed: the remaining scenario, and the past that counts.

It is separate from `replanning`, which solves it, so that checking a request loads no kernels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError
from shapely import Point as GeoPoint
from shapely import Polygon

from skyfolio.planner.altitudes import HIGHEST_M, LOWEST_M, plans_altitudes
from skyfolio.planner.arrays import Array
from skyfolio.planner.changes import Changes, ReplanError, uavs_after, users_after
from skyfolio.planner.corrections import CorrectionsDb
from skyfolio.planner.endurance import for_one_slot, in_the_air, proven_use_wh, while_energy_lasts
from skyfolio.planner.energy.parts import MOST_WH
from skyfolio.planner.plans import Cause, Plan
from skyfolio.planner.problem import Past
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, Point, Scenario, Uav, zone_holds

CLEAR_M = 1e-6
"""A live position inside a no-fly zone is taken this far outside its edge."""


def cause_of(changes: Changes, failed: Sequence[str] = ()) -> Cause:
    """Return the cause of a replan as far as the changes alone tell it."""
    gone = tuple(dict.fromkeys([*failed, *changes.failed]))
    if gone:
        return Cause(uav_ids=gone)
    if changes.returned:
        back = tuple(uav.id for uav in changes.returned)
        if changes.leaves_at:
            return Cause(kind="relief", uav_ids=(*back, *(uav for uav in changes.leaves_at if uav not in back)))
        return Cause(kind="uav_returned", uav_ids=back)
    if changes.leaves_at:
        return Cause(kind="ordered", uav_ids=tuple(changes.leaves_at))
    if changes.users_joined or changes.users_left:
        return Cause(kind="users_changed")
    if changes.utility or changes.bandwidth_hz:
        return Cause(kind="retuned")
    return Cause(kind="extended") if changes.slots is not None else Cause()


def remaining(
    previous: Plan,
    failed: Sequence[str],
    at_slot: int,
    positions_m: Mapping[str, tuple[float, float]] | None = None,
    achieved_rates_bps: Mapping[str, Sequence[float]] | None = None,
    changes: Changes | None = None,
    corrections_db: CorrectionsDb | None = None,
    *,
    altitudes_m: Mapping[str, float] | None = None,
    used_wh: Mapping[str, float] | None = None,
) -> tuple[Scenario, Past]:
    """Return the remaining scenario, with survivors at their live positions, and the past that counts; as in `replan`.

    Raises ReplanError for unknown ids, a slot outside the plan, no UAV or user left, survivors closer than `D_min`, an
    end position that is out of reach by now, altitudes or energies that are no such thing, or rates that are not
    finite, negative or of the wrong length.
    """
    changes = changes or Changes()
    gone = {*failed, *changes.failed}
    begin = at_slot - previous.first_slot
    _check_request(previous, gone, begin, positions_m)
    _check_live(previous, altitudes_m or {}, used_wh or {})
    if changes.origin not in {None, previous.scenario.origin}:
        raise ReplanError(f"origin: {changes.origin} is not that of plan {previous.id}, {previous.scenario.origin}")
    planned = {uav.id: previous.trajectories_m[uav.id][begin] for uav in previous.scenario.uavs}
    now = {**planned, **(positions_m or {})}
    before = [uav for uav in previous.scenario.uavs if uav.id not in gone and previous.scenario.last_slot(uav) >= begin]
    high, used = altitudes_m or {}, used_wh or {}
    survivors = tuple(
        _moved_on(previous, uav, now[uav.id], begin, high.get(uav.id), used.get(uav.id)) for uav in before
    )
    uavs, users = uavs_after(survivors, changes, at_slot), users_after(previous.scenario, changes, begin)
    if not uavs:
        raise ReplanError("failed: no UAV would be left to plan for")
    again: dict[str, Any] = {
        "utility": changes.utility or previous.scenario.utility,
        "channel": previous.scenario.channel.model_copy(
            update={} if corrections_db is None else {"corrections_db": corrections_db}
        ),
        "slots": changes.slots or previous.scenario.slots - begin,
    }
    try:
        uavs = for_one_slot(previous.scenario, uavs, {uav.id: proven_use_wh(previous, uav, begin) for uav in before})
        uavs = while_energy_lasts(previous.scenario, uavs, again["slots"])
        _require_one_that_stays(uavs, changes, again["slots"])
        scenario = previous.scenario.with_changes(uavs=uavs, users=users, **again)
    except ValidationError as error:
        raise ReplanError(_whose_fault(error, changes)) from error
    past = _for_users(scenario, changes, _achieved(previous, at_slot, achieved_rates_bps))
    counted = past if changes.slots is None else past[:, -changes.slots :]
    return scenario, Past(first_slot=at_slot, rates_bps=counted)


def rest_of_paths_m(previous: Plan, at_slot: int, changes: Changes | None = None) -> dict[str, list[Point]]:
    """Return the rest of each UAV's path in the previous plan, metres from slot `at_slot` on; not of UAVs that return.

    Those of failed UAVs are among them. Where the new plan has more slots, they hover on at their last place.
    """
    changes = changes or Changes()
    returned = {uav.id for uav in changes.returned}
    begin = at_slot - previous.first_slot
    slots = changes.slots or previous.scenario.slots - begin
    return {
        uav: [*path[begin : begin + slots], *[path[-1]] * (slots - len(path[begin:]))]
        for uav, path in previous.trajectories_m.items()
        if uav not in returned
    }


def places_changed_m(
    previous: Plan, at_slot: int, failed: Sequence[str] = (), changes: Changes | None = None
) -> list[Point] | None:
    """Return the places, in metres, at which something is different: None where that is everywhere or nowhere known.

    Of UAVs: where they are at `at_slot` and where they were to end. Of users: where they are.
    """
    changes = changes or Changes()
    if changes.utility is not None or changes.slots is not None:
        return None
    begin = at_slot - previous.first_slot
    named = {*failed, *changes.failed, *changes.bandwidth_hz, *changes.leaves_at, *changes.ends_m}
    uavs = named & set(previous.trajectories_m)
    paths = [previous.trajectories_m[uav] for uav in sorted(uavs)]
    gone = [user.position_m for user in previous.scenario.users if user.id in changes.users_left]
    come = [uav.start_m for uav in changes.returned] + [user.position_m for user in changes.users_joined]
    return [place for path in paths for place in (path[begin], path[-1])] + gone + come or None


def _whose_fault(error: ValidationError, changes: Changes) -> str:
    """Return the broken rule of the remaining scenario, preceded by the field of the request that broke it."""
    said = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
    if said.startswith("users"):
        joined = changes.slots is None or any(f"'{user.id}'" in said for user in changes.users_joined)
        return f"{'users_joined' if joined else 'slots'}: {said.removeprefix('users: ')}"
    named = {
        "returned": [uav.id for uav in changes.returned],
        "ends_m": list(changes.ends_m),
        "leaves_at": list(changes.leaves_at),
    }
    fields = [field for field, uavs in named.items() if any(f"'{uav}'" in said for uav in uavs)]
    return f"{[*fields, 'positions_m' if changes.slots is None else 'slots'][0]}: {said}"


def _require_one_that_stays(uavs: tuple[Uav, ...], changes: Changes, slots: int) -> None:
    """Refuse more slots than any UAV can stay, and leaves that take all of them away. Raises ReplanError."""
    longest = max(slots if uav.leaves_at_slot is None else uav.leaves_at_slot for uav in uavs)
    if longest < slots and changes.slots is not None:
        raise ReplanError(f"slots: {slots} are too many, every UAV has left after {longest} slots")
    if longest < slots and changes.leaves_at:
        raise ReplanError(f"leaves_at: every UAV would have left after {longest} of {slots} slots; one must stay")


def _check_live(previous: Plan, altitudes_m: Mapping[str, float], used_wh: Mapping[str, float]) -> None:
    """Raise ReplanError for a UAV that is unknown, and for what is no altitude and no energy."""
    for field, given, least, most in (
        ("altitudes_m", altitudes_m, LOWEST_M, HIGHEST_M),
        ("used_wh", used_wh, 0, MOST_WH),
    ):
        for uav, value in given.items():
            if uav not in previous.scenario.uav_ids:
                raise ReplanError(f"{field}: {uav!r} is not a UAV of plan {previous.id}")
            if not least <= value <= most:
                raise ReplanError(f"{field}.{uav}: {value} must be a number from {least} to {most:g}")
    if altitudes_m and previous.altitudes_m is None:
        raise ReplanError(f"altitudes_m: plan {previous.id} has no altitudes")


def _check_request(
    previous: Plan, failed: set[str], begin: int, positions_m: Mapping[str, tuple[float, float]] | None
) -> None:
    known = previous.scenario.uav_ids
    for field, ids in (("failed", failed), ("positions_m", list(positions_m or {}))):
        unknown = sorted(one for one in ids if one not in known)
        if unknown:
            raise ReplanError(f"{field}: {unknown[0]!r} is not a UAV of plan {previous.id}")
    if not 0 <= begin < previous.scenario.slots:
        last = previous.first_slot + previous.scenario.slots - 1
        raise ReplanError(f"at_slot: {begin + previous.first_slot} must lie in {previous.first_slot}..{last}")


def _moved_on(
    previous: Plan, uav: Uav, now: Sequence[float], begin: int, altitude_m: float | None, used_wh: float | None
) -> Uav:
    """Return the UAV `begin` slots later at its live position and altitude, with so much used of its battery.

    Without an altitude it is at the one that the plan has for it then; what it has used is at least what is proven.
    """
    scenario = previous.scenario
    leaves = None if uav.leaves_at_slot is None else uav.leaves_at_slot - begin
    moved: dict[str, Any] = {"start_m": _into_flying_area(scenario, now), "leaves_at_slot": leaves}
    for name in ("on_air_from_slot", "off_air_from_slot"):
        at = getattr(uav, name)
        moved |= {} if at is None else {name: max(at - begin, 0)}
    if plans_altitudes(scenario) and previous.altitudes_m is not None:
        there_m = previous.altitudes_m[uav.id][begin] if altitude_m is None else float(altitude_m)
        moved |= {"home_m": uav.home_m or uav.start_m, "start_altitude_m": there_m}
    there = uav.model_copy(update=moved)
    if uav.battery is None:
        return there
    proven_wh = proven_use_wh(previous, uav, begin)
    use_wh = proven_wh if used_wh is None else max(float(used_wh), proven_wh or 0.0)
    return in_the_air(there, home_m=uav.home_m or uav.start_m, used_wh=use_wh)


def _into_flying_area(scenario: Scenario, point: Sequence[float]) -> Point:
    """Move a live position slightly outside the area, or inside a no-fly zone, to the edge; the plan leads back."""
    (west, south), (east, north) = scenario.area_m
    inside = min(max(float(point[0]), west), east), min(max(float(point[1]), south), north)
    for zone in scenario.no_fly:
        if zone_holds(zone, inside):
            inside = _out_of(zone, inside)
    return inside


def _out_of(zone: NoFlyDisc | NoFlyPolygon, point: Point) -> Point:
    at = GeoPoint(point)
    if isinstance(zone, NoFlyDisc):
        east, north = point[0] - zone.center_m[0], point[1] - zone.center_m[1]
        away = float(np.hypot(east, north))
        east, north = (east / away, north / away) if away > 0.0 else (1.0, 0.0)
        radius = zone.radius_m + CLEAR_M
        return zone.center_m[0] + radius * east, zone.center_m[1] + radius * north
    edge = Polygon(zone.vertices_m).exterior
    nearest = edge.interpolate(edge.project(at))
    depth = nearest.distance(at)
    share = 1.0 if depth == 0.0 else 1.0 + CLEAR_M / depth
    return point[0] + share * (nearest.x - point[0]), point[1] + share * (nearest.y - point[1])


def _achieved(previous: Plan, at_slot: int, given: Mapping[str, Sequence[float]] | None) -> dict[str, list[float]]:
    """Return each user's rates in bit/s in the slots before the new plan that count: as reported, otherwise as planned.

    Rates that are given for all slots of the operation are cut to those that count.
    """
    unknown = [user for user in given or {} if user not in previous.scenario.user_ids]
    if unknown:
        raise ReplanError(f"achieved_rates_bps: {unknown[0]!r} is not a user of plan {previous.id}")
    begin = at_slot - previous.first_slot
    rates = {}
    for user in previous.scenario.user_ids:
        promised = [*previous.achieved_rates_bps.get(user, []), *previous.user_rates_bps[user][:begin]]
        row = list(given[user]) if given and user in given else promised
        if len(row) not in {len(promised), at_slot}:
            raise ReplanError(f"achieved_rates_bps.{user}: has {len(row)} slots, but {len(promised)} have passed")
        if not all(np.isfinite(row)) or min(row, default=0.0) < 0:
            raise ReplanError(f"achieved_rates_bps.{user}: rates must be finite and not negative")
        rates[user] = row[len(row) - len(promised) :]
    return rates


def _for_users(scenario: Scenario, changes: Changes, achieved: dict[str, list[float]]) -> Array:
    """Return (K, M) bit/s for the users of the new scenario, NaN in the slots before a user was there."""
    new = {user.id for user in changes.users_joined}
    slots = max(len(row) for row in achieved.values())
    table = np.full((len(scenario.users), slots), np.nan)
    for row, user in zip(table, scenario.user_ids, strict=True):
        if user not in new and achieved[user]:
            row[slots - len(achieved[user]) :] = achieved[user]
    return table
