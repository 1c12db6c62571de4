"""What PX4 sends of an item that is read back, as `MavlinkMissionManager` reads it from storage (1.18).

The plan itself is kept, and flown, as it was sent, and so is its checksum. Read back, items with a place come in the
INT frames, without the parameters that PX4 has no use for and with the yaw within one turn. Fences keep no frame and
come back with autocontinue 0.
"""

import math
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.missions import FENCE_CIRCLES, FENCE_POLYGONS, RELATIVE_FRAMES, MissionItem

_FENCE = dialect.MAV_MISSION_TYPE_FENCE


def as_read(item: MissionItem, mission_type: int) -> MissionItem:
    """Return an item as it is read back."""
    if item.frame == dialect.MAV_FRAME_MISSION:
        return item
    relative = item.frame in RELATIVE_FRAMES and mission_type != _FENCE
    frame = int(dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT if relative else dialect.MAV_FRAME_GLOBAL_INT)
    param1, param2, param3, param4 = _params(item)
    kept = replace(item, frame=frame, param1=param1, param2=param2, param3=param3, param4=param4)
    return replace(kept, autocontinue=0 if mission_type == _FENCE else int(bool(item.autocontinue)))


def _params(item: MissionItem) -> tuple[float, float, float, float]:
    command = item.command
    if command == dialect.MAV_CMD_NAV_WAYPOINT:
        return item.param1, item.param2, 0.0, _yaw_deg(item)
    if command == dialect.MAV_CMD_NAV_LOITER_UNLIM:
        return 0.0, 0.0, item.param3, _yaw_deg(item)
    if command == dialect.MAV_CMD_NAV_LOITER_TIME:
        return item.param1, float(item.param2 > 0.0), item.param3, float(item.param4 > 0.0)
    if command == dialect.MAV_CMD_NAV_LAND:
        return item.param1, float(int(item.param2)), 0.0, _yaw_deg(item)
    if command == dialect.MAV_CMD_NAV_TAKEOFF:
        return 0.0, 0.0, 0.0, _yaw_deg(item)
    if command in FENCE_POLYGONS:
        return float(int(item.param1 + 0.5)), 0.0, 0.0, 0.0
    return item.param1 if command in FENCE_CIRCLES else 0.0, 0.0, 0.0, 0.0


def _yaw_deg(item: MissionItem) -> float:
    return item.param4 % 360.0 if math.isfinite(item.param4) else item.param4
