"""A scenario and a plan as features: what exports write, and what is read back by an import."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.base import BaseGeometry

from skyfolio.api.places.assembling import ScenarioSettings
from skyfolio.api.places.properties import NESTED, VELOCITY
from skyfolio.planner import Plan, Scenario, Uav
from skyfolio.planner.geodesy import points_to_geodetic
from skyfolio.planner.places import closings_m, four_corners
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, PositionDeg, User

DECIMALS_DEG = 12
"""A ten-thousandth of a millimetre: metres of up to six decimals are read back to the bit."""
Metres = tuple[float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Outlined:
    """One feature. geometry: longitude and latitude, degrees; height_m: of what flies, at each of its places.

    above_sea: whether that counts from mean sea level, not from home.
    """

    kind: str
    name: str
    geometry: BaseGeometry
    properties: Mapping[str, Any]
    height_m: tuple[float, ...] | None = None
    above_sea: bool = False


def settings_of(scenario: Scenario) -> dict[str, Any]:
    """Return what of a scenario is no place, as plain JSON."""
    return scenario.model_dump(mode="json", include=set(ScenarioSettings.model_fields))


def features_of(scenario: Scenario) -> list[Outlined]:
    """Return a scenario's area, zones, users, UAVs and rally points."""
    return [_area(scenario), *_zones(scenario), *_users(scenario), *_uavs(scenario), *_rally(scenario)]


def features_of_plan(plan: Plan) -> list[Outlined]:
    """Return the features of a plan's scenario, the users with their rates, and each UAV's path and its positions."""
    return [
        _area(plan.scenario),
        *_zones(plan.scenario),
        *_users(plan.scenario, plan),
        *_uavs(plan.scenario),
        *_rally(plan.scenario),
        *_flown(plan),
    ]


def positions(plan: Plan) -> Iterator[dict[str, Any]]:
    """Yield where each UAV is when each slot begins, and whom it serves with what: a row for each slot and UAV.

    Slots and seconds count from the beginning of the operation; a UAV that has left has no more rows.
    """
    scenario = plan.scenario
    heights = _heights_m(plan)
    degrees = {uav.id: _degrees(scenario, plan.trajectories_m[uav.id]) for uav in scenario.uavs}
    for n in range(scenario.slots):
        slot = plan.first_slot + n
        for uav in scenario.uavs:
            if n > scenario.last_slot(uav):
                continue
            served = [user for user in scenario.user_ids if _serves(plan, uav.id, user, n)]
            (east_m, north_m), (lat, lon) = plan.trajectories_m[uav.id][n], degrees[uav.id][n]
            yield {
                "slot": slot,
                "starts_at_s": slot * scenario.slot_duration_s,
                "uav_id": uav.id,
                "lat_deg": lat,
                "lon_deg": lon,
                "altitude_m": heights[uav.id][n],
                "east_m": east_m,
                "north_m": north_m,
                "users": " ".join(served),
                "bandwidth_hz": sum(plan.bandwidth_hz[user][n] for user in served),
                "rate_bps": sum(plan.user_rates_bps[user][n] for user in served),
            }


def _heights_m(plan: Plan) -> Mapping[str, Sequence[float]]:
    """Return the altitudes of each UAV in each slot, in the plan's own datum."""
    if plan.altitudes_m is not None:
        return plan.altitudes_m
    scenario = plan.scenario
    return {uav.id: [scenario.altitude_of(uav)] * scenario.slots for uav in scenario.uavs}


def _serves(plan: Plan, uav: str, user: str, n: int) -> bool:
    return plan.association[user][n] == uav and plan.bandwidth_hz[user][n] > 0


def _flown(plan: Plan) -> list[Outlined]:
    """Return all paths, then all positions."""
    rows = list(positions(plan))
    above_sea = plan.altitudes_m is not None and plan.scenario.terrain is not None
    paths, slots = [], []
    for uav in plan.scenario.uavs:
        own = [row for row in rows if row["uav_id"] == uav.id]
        heights = tuple(row["altitude_m"] for row in own)
        places = [(row["lon_deg"], row["lat_deg"]) for row in own]
        told = {"uav_id": uav.id, "first_slot": plan.first_slot, "altitude_m": max(heights)}
        path = LineString(places if len(places) > 1 else places * 2)
        way = Outlined(kind="path", name=f"{uav.id}-path", geometry=path, properties=told, above_sea=above_sea)
        paths.append(replace(way, height_m=heights if len(places) > 1 else heights * 2))
        for row, place in zip(own, places, strict=True):
            told = {name: value for name, value in row.items() if name not in {"lat_deg", "lon_deg"}}
            name = f"{uav.id}-slot-{row['slot']}"
            at = Point(place)
            here = Outlined(kind="position", name=name, geometry=at, properties=told, above_sea=above_sea)
            slots.append(replace(here, height_m=(row["altitude_m"],)))
    return [*paths, *slots]


def _area(scenario: Scenario) -> Outlined:
    if scenario.area_deg is None:
        (west, south), (east, north) = scenario.area_m
        places = _degrees(scenario, [(west, south), (east, south), (east, north), (west, north)])
    else:
        given = four_corners(scenario.area_deg) if len(scenario.area_deg) == 2 else scenario.area_deg
        places = [(place.lat, place.lon) for place in given]
    return Outlined(kind="area", name="area", geometry=_polygon(places), properties={})


def _zones(scenario: Scenario) -> Iterator[Outlined]:
    """Yield the no-fly zones, less those that only close off what is outside of the area."""
    closed = [] if scenario.area_deg is None else closings_m(scenario.origin, scenario.area_deg)
    for number, zone in enumerate(scenario.no_fly, start=1):
        name = f"no_fly-{number}"
        if isinstance(zone, NoFlyDisc):
            at = _place(scenario, zone.center_m, zone.center_deg)
            yield Outlined(kind="no_fly", name=name, geometry=at, properties={"radius_m": zone.radius_m})
        elif [*map(tuple, zone.vertices_m)] not in closed:
            yield Outlined(kind="no_fly", name=name, geometry=_outline(scenario, zone), properties={})


def _users(scenario: Scenario, plan: Plan | None = None) -> Iterator[Outlined]:
    for user in scenario.users:
        rates = {} if plan is None else {"mean_rate_bps": _mean(plan.user_rates_bps[user.id])}
        yield Outlined(
            kind="user", name=user.id, geometry=_where(scenario, user), properties={**_numbers(user), **rates}
        )


def _where(scenario: Scenario, user: User) -> Point | LineString:
    """Return a user's place, or the line through its places, one for each slot."""
    if user.positions_m is None or len(user.positions_m) < 2:
        return _place(scenario, user.position_m, user.position_deg)
    if user.positions_deg is not None:
        return LineString([(place.lon, place.lat) for place in user.positions_deg])
    return LineString([(lon, lat) for lat, lon in _degrees(scenario, user.positions_m)])


def _uavs(scenario: Scenario) -> Iterator[Outlined]:
    for uav in scenario.uavs:
        told = _numbers(uav)
        if uav.end_m is not None:
            end = _place(scenario, uav.end_m, uav.end_deg)
            told |= {"end_lat_deg": end.y, "end_lon_deg": end.x}
        at = _place(scenario, uav.start_m, uav.start_deg)
        yield Outlined(kind="uav", name=uav.id, geometry=at, properties=told)


def _rally(scenario: Scenario) -> Iterator[Outlined]:
    for number, point in enumerate(scenario.rally_points, start=1):
        at = _place(scenario, point.position_m, point.position_deg)
        yield Outlined(kind="rally_point", name=f"rally_point-{number}", geometry=at, properties={})


def _numbers(part: User | Uav) -> dict[str, Any]:
    """Return what is said of a user or UAV beside its id and its places."""
    told = {name: value for name, value in part.model_dump(mode="json").items() if isinstance(value, int | float)}
    if isinstance(part, Uav):
        owned = {column: getattr(getattr(part, whose), name, None) for column, (whose, name) in NESTED.items()}
        return told | {column: value for column, value in owned.items() if value is not None}
    return told if part.velocity_mps is None else told | dict(zip(VELOCITY, part.velocity_mps, strict=True))


def _place(scenario: Scenario, metres: Metres, degrees: PositionDeg | None) -> Point:
    lat, lon = _degrees(scenario, [metres])[0] if degrees is None else (degrees.lat, degrees.lon)
    return Point(lon, lat)


def _outline(scenario: Scenario, zone: NoFlyPolygon) -> Polygon:
    given = zone.vertices_deg
    return _polygon(_degrees(scenario, zone.vertices_m) if given is None else [(one.lat, one.lon) for one in given])


def _polygon(places: Sequence[tuple[float, float]]) -> Polygon:
    """Return a polygon of (lat, lon), its outer ring against the clock as RFC 7946 wants it."""
    polygon = Polygon([(lon, lat) for lat, lon in places])
    return polygon if polygon.exterior.is_ccw else polygon.reverse()


def _degrees(scenario: Scenario, points_m: Sequence[Metres]) -> list[tuple[float, float]]:
    places = points_to_geodetic(scenario.origin, points_m)
    return [(round(lat, DECIMALS_DEG), round(lon, DECIMALS_DEG)) for lat, lon in places]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
