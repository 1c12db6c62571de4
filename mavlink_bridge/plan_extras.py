"""Geofence and rally points of a QGroundControl .plan file, out and in: mission items of types 1 and 2.

A polygon is a run of MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION or _EXCLUSION (5001, 5002) items whose param1 is the
number of its vertices; a circle is one item (5003, 5004) whose param1 is its radius in metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from skyfolio.mavlink_bridge.e7 import from_e7, to_e7
from skyfolio.mavlink_bridge.errors import FormatError
from skyfolio.mavlink_bridge.items import Command, Frame, MissionItem

_POLYGON = {
    True: Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    False: Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
}
_CIRCLE = {True: Command.NAV_FENCE_CIRCLE_INCLUSION, False: Command.NAV_FENCE_CIRCLE_EXCLUSION}
_IS_INCLUSION = {command: inclusion for table in (_POLYGON, _CIRCLE) for inclusion, command in table.items()}
_LEAST_VERTICES = 3
_MALFORMED = (KeyError, TypeError, ValueError, IndexError)


def fence_to_json(items: Sequence[MissionItem]) -> dict[str, Any]:
    """Return the `geoFence` object of a .plan. Raises FormatError for an item that is no part of a fence."""
    circles: list[dict[str, Any]] = []
    polygons: list[dict[str, Any]] = []
    position = 0
    while position < len(items):
        item = items[position]
        if item.command not in _IS_INCLUSION:
            raise FormatError(f"fence.{position}.command: {item.command} is no part of a fence of a .plan")
        common = {"inclusion": _IS_INCLUSION[Command(item.command)], "version": 1}
        if item.command in _CIRCLE.values():
            circles.append({**common, "circle": {"center": [from_e7(item.x), from_e7(item.y)], "radius": item.param1}})
            position += 1
            continue
        count = int(item.param1)
        vertices = items[position : position + count]
        if len(vertices) < max(count, _LEAST_VERTICES) or any(vertex.command != item.command for vertex in vertices):
            raise FormatError(f"fence.{position}: a polygon of {count} vertices, of which not all follow")
        polygons.append({**common, "polygon": [[from_e7(vertex.x), from_e7(vertex.y)] for vertex in vertices]})
        position += count
    return {"version": 2, "circles": circles, "polygons": polygons}


def rally_to_json(items: Sequence[MissionItem]) -> dict[str, Any]:
    """Return the `rallyPoints` object of a .plan."""
    return {"version": 2, "points": [[from_e7(item.x), from_e7(item.y), item.z] for item in items]}


def fence_from_qgc_plan(plan: Mapping[str, Any]) -> tuple[MissionItem, ...]:
    """Return every polygon and circle of a .plan as items of mission type 1, polygons first; empty without a fence.

    Raises FormatError that names what is malformed or cannot be taken.
    """
    try:
        fence = plan["geoFence"]
        items: list[MissionItem] = []
        for number, polygon in enumerate(fence.get("polygons", ())):
            items += _polygon(f"geoFence.polygons.{number}", len(items), polygon)
        for number, circle in enumerate(fence.get("circles", ())):
            items.append(_circle(f"geoFence.circles.{number}", len(items), circle))
    except _MALFORMED as error:
        raise FormatError(f"not a QGroundControl plan: {type(error).__name__} at {error}") from error
    if fence.get("breachReturn") is not None:
        raise FormatError("geoFence.breachReturn: a breach return point is not taken; use a rally point")
    return tuple(items)


def rally_from_qgc_plan(plan: Mapping[str, Any]) -> tuple[MissionItem, ...]:
    """Return the rally points of a .plan as items of mission type 2. Raises FormatError."""
    try:
        return tuple(
            _item(f"rallyPoints.points.{seq}", seq, Command.NAV_RALLY_POINT, 0.0, point)
            for seq, point in enumerate(plan["rallyPoints"]["points"])
        )
    except _MALFORMED as error:
        raise FormatError(f"not a QGroundControl plan: {type(error).__name__} at {error}") from error


def _polygon(where: str, seq: int, polygon: Mapping[str, Any]) -> list[MissionItem]:
    vertices, command = polygon["polygon"], _POLYGON[_inclusion(where, polygon)]
    if len(vertices) < _LEAST_VERTICES:
        raise FormatError(f"{where}.polygon: {len(vertices)} vertices, must be at least {_LEAST_VERTICES}")
    count = float(len(vertices))
    return [_item(f"{where}.polygon.{n}", seq + n, command, count, (*vertex, 0.0)) for n, vertex in enumerate(vertices)]


def _circle(where: str, seq: int, circle: Mapping[str, Any]) -> MissionItem:
    round_ = circle["circle"]
    radius_m = float(round_["radius"])
    if not (isfinite(radius_m) and radius_m > 0):
        raise FormatError(f"{where}.circle.radius: {radius_m} must be more than 0 m")
    return _item(f"{where}.circle.center", seq, _CIRCLE[_inclusion(where, circle)], radius_m, (*round_["center"], 0.0))


def _inclusion(where: str, part: Mapping[str, Any]) -> bool:
    if not isinstance(part["inclusion"], bool):
        raise FormatError(f"{where}.inclusion: {part['inclusion']!r} must be true or false")
    return part["inclusion"]


def _item(where: str, seq: int, command: Command, param1: float, place: Sequence[Any]) -> MissionItem:
    """Make one item at (latitude, longitude in degrees, altitude in metres)."""
    lat_deg, lon_deg, z = (float(value) for value in place)
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180 and isfinite(z)):
        raise FormatError(f"{where}: {list(place)} is not a latitude and a longitude in degrees, and a height")
    frame = Frame.GLOBAL_RELATIVE_ALT if command == Command.NAV_RALLY_POINT else Frame.GLOBAL
    return MissionItem(seq=seq, frame=frame, command=command, param1=param1, x=to_e7(lat_deg), y=to_e7(lon_deg), z=z)
