"""Missions as files: QGroundControl's .plan (JSON) and the older .waypoints text, out and in.

Both hold degrees, so 1e-7 degree integers survive exactly (JSON at full precision, text at 8 decimals). Files use
frame 3 where the wire uses 6: same datum, metres above the vehicle's own home. The home item an ArduPilot mission
begins with is row 0 of a .waypoints file and `plannedHomePosition` of a .plan; a .plan carries geofence and rally
points too (`plan_extras`). A parameter that is null in a .plan is NaN on the wire: the vehicle keeps its own value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isinf, isnan, nan
from typing import Any

from skyfolio.mavlink_bridge.autopilots import MavAutopilot
from skyfolio.mavlink_bridge.e7 import from_e7, to_e7
from skyfolio.mavlink_bridge.errors import FormatError
from skyfolio.mavlink_bridge.items import Command, Frame, Mission, MissionItem
from skyfolio.mavlink_bridge.plan_extras import fence_to_json, rally_to_json
from skyfolio.mavlink_bridge.profiles import KNOWN, profile_in_heartbeat, profile_of

_VEHICLE_QUADROTOR = 2
_ALTITUDE_RELATIVE, _ALTITUDE_ABSOLUTE = 1, 2
_HEADER = "QGC WPL 110"
_COLUMNS = 12


def to_qgc_plan(
    mission: Mission,
    *,
    home_alt_m: float = 0.0,
    hover_speed_mps: float = 5.0,
    fence: Sequence[MissionItem] = (),
    rally: Sequence[MissionItem] = (),
) -> dict[str, Any]:
    """Return the mission as the JSON object of a QGroundControl .plan file.

    The planned home is the first position of the mission; home_alt_m is its height above mean sea level, which a
    plan does not know and QGroundControl only draws with. `fence`: items of mission type 1 (polygons and circles),
    `rally`: items of type 2, as `fence_items` and `rally_items` make them. Raises FormatError for a fence item that a
    .plan cannot hold.
    """
    first = next(item for item in mission.items if item.has_position)
    profile = profile_of(mission.autopilot)
    flown = mission.items[int(profile.home_first) :]
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": int(profile.mav_autopilot),
            "vehicleType": _VEHICLE_QUADROTOR,
            "cruiseSpeed": hover_speed_mps,
            "hoverSpeed": hover_speed_mps,
            "globalPlanAltitudeMode": _altitude_mode(next(item for item in flown if item.has_position)),
            "plannedHomePosition": [from_e7(first.x), from_e7(first.y), home_alt_m],
            "items": [_to_simple_item(number, item) for number, item in enumerate(flown, start=1)],
        },
        "geoFence": fence_to_json(fence),
        "rallyPoints": rally_to_json(rally),
    }


def from_qgc_plan(plan: Mapping[str, Any]) -> tuple[MissionItem, ...]:
    """Return the mission items of a .plan file of simple items. Raises FormatError for anything else."""
    try:
        if plan["fileType"] != "Plan":
            raise FormatError(f"fileType: {plan['fileType']!r} must be 'Plan'")
        mission = plan["mission"]
        home = [_home_item(mission)] if _has_home(mission) else []
        items = [_from_simple_item(seq, item) for seq, item in enumerate(mission["items"], start=len(home))]
        return (*home, *items)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise FormatError(f"not a QGroundControl plan: {type(error).__name__} at {error}") from error


def _has_home(mission: Mapping[str, Any]) -> bool:
    """Return whether the mission's first item is home, and in the file `plannedHomePosition`.

    A file for any vehicle (firmwareType 0, or none) has plain items. Raises FormatError for an unknown autopilot.
    """
    firmware = MavAutopilot(mission.get("firmwareType", MavAutopilot.GENERIC))
    if firmware is MavAutopilot.GENERIC:
        return False
    profile = profile_in_heartbeat(firmware)
    if profile is None:
        raise FormatError(f"mission.firmwareType: {firmware.name} ({int(firmware)}) is not {KNOWN}")
    return profile.home_first


def to_waypoints(mission: Mission) -> str:
    """Return the mission as "QGC WPL 110" text: one tab-separated row per item, coordinates with 8 decimals."""
    return "\n".join([_HEADER, *(_to_row(item) for item in mission.items)]) + "\n"


def from_waypoints(text: str) -> tuple[MissionItem, ...]:
    """Return the items of a "QGC WPL 110" file. Raises FormatError naming the line.

    Empty lines and comments (`#`) are passed over, and rows may be numbered from 0 or, as some tools do, from 1.
    """
    lines = text.removeprefix("\ufeff").splitlines()
    if not lines or lines[0].strip() != _HEADER:
        raise FormatError(f"line 1: must be '{_HEADER}'")
    rows = [(number, line.split()) for number, line in enumerate(lines[1:], start=2) if _holds_data(line)]
    first = 1 if rows and rows[0][1][0] == "1" else 0
    return tuple(_from_row(seq, first, number, cells) for seq, (number, cells) in enumerate(rows))


def _holds_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _home_item(mission: Mapping[str, Any]) -> MissionItem:
    lat_deg, lon_deg, alt_m = (float(value) for value in mission["plannedHomePosition"])
    where = "mission.plannedHomePosition"
    return _item(where, 0, Frame.GLOBAL, Command.NAV_WAYPOINT, 1, 1, [0.0, 0.0, 0.0, 0.0, lat_deg, lon_deg, alt_m])


def _to_simple_item(number: int, item: MissionItem) -> dict[str, Any]:
    values = {
        "type": "SimpleItem",
        "autoContinue": bool(item.autocontinue),
        "command": int(item.command),
        "doJumpId": number,
        "frame": _file_frame(item.frame),
        "params": [
            *(None if isnan(value) else value for value in (item.param1, item.param2, item.param3, item.param4)),
            *(from_e7(item.x), from_e7(item.y), item.z),
        ],
    }
    if item.has_position:
        values |= {"Altitude": item.z, "AltitudeMode": _altitude_mode(item), "AMSLAltAboveTerrain": None}
    return values


def _altitude_mode(item: MissionItem) -> int:
    return _ALTITUDE_ABSOLUTE if item.frame == Frame.GLOBAL else _ALTITUDE_RELATIVE


def _from_simple_item(seq: int, item: Mapping[str, Any]) -> MissionItem:
    if item["type"] != "SimpleItem":
        raise FormatError(f"items.{seq}.type: {item['type']!r} must be 'SimpleItem'")
    params, frame = item["params"], int(item["frame"])
    if len(params) != 7:
        raise FormatError(f"items.{seq}.params: {len(params)} values, must be 7")
    if params[6] is None and frame != Frame.MISSION:
        raise FormatError(f"items.{seq}.params.6: null, but an item with a place needs its altitude")
    numbers = [nan if value is None else float(value) for value in params[:4]]
    numbers += [0.0 if value is None else float(value) for value in params[4:]]  # no place: where the vehicle is
    return _item(f"items.{seq}", seq, frame, int(item["command"]), int(seq == 0), int(item["autoContinue"]), numbers)


def _to_row(item: MissionItem) -> str:
    whole = (item.seq, item.current, _file_frame(item.frame), int(item.command))
    params = (item.param1, item.param2, item.param3, item.param4)
    place = (f"{from_e7(item.x):.8f}", f"{from_e7(item.y):.8f}", f"{item.z:.6f}")
    return "\t".join([*map(str, whole), *(f"{param:.8f}" for param in params), *place, str(item.autocontinue)])


def _from_row(seq: int, first: int, number: int, cells: Sequence[str]) -> MissionItem:
    if len(cells) != _COLUMNS:
        raise FormatError(f"line {number}: {len(cells)} columns, must be {_COLUMNS}")
    try:
        frame, command = int(cells[2]), int(cells[3])
        numbers = [float(cell) for cell in cells[4:11]]
        if int(cells[0]) != seq + first:
            raise FormatError(f"line {number}: item {cells[0]}, must be {seq + first}")
        return _item(f"line {number}", seq, frame, command, int(cells[1]), int(cells[11]), numbers)
    except ValueError as error:
        raise FormatError(f"line {number}: {error}") from error


def _item(
    where: str,
    seq: int,
    frame: int,
    command: int,
    current: int,
    autocontinue: int,
    numbers: Sequence[float],
) -> MissionItem:
    """Make one item from param1..4 (NaN: not given), latitude, longitude (degrees), altitude (metres); frame 3 is 6."""
    *params, lat_deg, lon_deg, z = numbers
    if any(map(isinf, numbers)) or any(map(isnan, (lat_deg, lon_deg, z))):
        raise FormatError(f"{where}: {list(numbers)} must be finite (a parameter may be null)")
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):
        raise FormatError(f"{where}: ({lat_deg}, {lon_deg}) is not a latitude and a longitude in degrees")
    return MissionItem(
        seq=seq,
        frame=Frame.GLOBAL_RELATIVE_ALT_INT if frame == Frame.GLOBAL_RELATIVE_ALT else frame,
        command=Command(command) if command in set(Command) else command,
        current=current,
        autocontinue=autocontinue,
        param1=params[0],
        param2=params[1],
        param3=params[2],
        param4=params[3],
        x=to_e7(lat_deg),
        y=to_e7(lon_deg),
        z=z,
    )


def _file_frame(frame: int) -> int:
    return int(Frame.GLOBAL_RELATIVE_ALT if frame == Frame.GLOBAL_RELATIVE_ALT_INT else frame)
