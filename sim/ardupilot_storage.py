"""What ArduCopter's storage keeps of an item, as AP_Mission, AC_Fence and AP_Rally have it (4.6).

15 bytes hold an item of a mission: whole seconds of a hold, centimetres of altitude, no acceptance radius and no yaw
of a waypoint; the frame comes back as GLOBAL or GLOBAL_RELATIVE_ALT, autocontinue as 1, and of a landing's param4 only
a sign. Fences keep no altitude and no frame, rally points whole metres, and both come back with autocontinue 0.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.missions import FENCE_CIRCLES, FENCE_POLYGONS, RELATIVE_FRAMES, MissionItem

_PLACELESS = (dialect.MAV_CMD_DO_CHANGE_SPEED, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH, dialect.MAV_CMD_NAV_DELAY)
_Params = tuple[float, float, float, float]


def as_stored(item: MissionItem, mission_type: int = dialect.MAV_MISSION_TYPE_MISSION) -> MissionItem:
    """Return an item as it is read back."""
    return _STORES[mission_type](replace(item, current=0))


def _mission(item: MissionItem) -> MissionItem:
    param1, param2, param3, param4 = _params(item)
    kept = replace(item, autocontinue=1, param1=param1, param2=param2, param3=param3, param4=param4)
    if item.command in _PLACELESS:
        return replace(kept, frame=dialect.MAV_FRAME_GLOBAL, x=0, y=0, z=0.0)
    return replace(kept, frame=_frame(item), z=_centimetres(item.z))


def _params(item: MissionItem) -> _Params:
    command = item.command
    if command == dialect.MAV_CMD_DO_CHANGE_SPEED:
        return float(int(item.param1)), item.param2, item.param3, 0.0
    if command == dialect.MAV_CMD_NAV_DELAY:
        return item.param1, float(int(item.param2)), float(int(item.param3)), float(int(item.param4))
    if command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH:
        return 0.0, 0.0, 0.0, 0.0
    if command == dialect.MAV_CMD_NAV_LOITER_UNLIM:
        return 0.0, 0.0, math.copysign(_whole(abs(item.param3)), item.param3), 0.0
    if command == dialect.MAV_CMD_NAV_LOITER_TIME:
        return _whole(item.param1), 0.0, _direction(item.param3), float(item.param4 > 0.0)
    if command == dialect.MAV_CMD_NAV_LAND:
        return _whole(item.param1), 0.0, 0.0, _direction(item.param4)
    return _whole(item.param1), 0.0, 0.0, 0.0


def _fence(item: MissionItem) -> MissionItem:
    param1 = 0.0
    if item.command in FENCE_POLYGONS:
        param1 = _whole(item.param1)
    elif item.command in FENCE_CIRCLES:
        param1 = float(int(item.param1)) if item.param1 - int(item.param1) < 0.001 else item.param1
    bare = replace(item, autocontinue=0, frame=dialect.MAV_FRAME_GLOBAL, z=0.0)
    return replace(bare, param1=param1, param2=0.0, param3=0.0, param4=0.0)


def _rally(item: MissionItem) -> MissionItem:
    bare = replace(item, autocontinue=0, frame=_frame(item), z=float(math.trunc(item.z)))
    return replace(bare, param1=0.0, param2=0.0, param3=0.0, param4=0.0)


_STORES: dict[int, Callable[[MissionItem], MissionItem]] = {
    dialect.MAV_MISSION_TYPE_MISSION: _mission,
    dialect.MAV_MISSION_TYPE_FENCE: _fence,
    dialect.MAV_MISSION_TYPE_RALLY: _rally,
}


def _frame(item: MissionItem) -> int:
    relative = item.frame in RELATIVE_FRAMES
    return int(dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT if relative else dialect.MAV_FRAME_GLOBAL)


def _direction(value: float) -> float:
    return -1.0 if value < 0.0 else 1.0


def _whole(value: float) -> float:
    return float(int(value)) if 0.0 <= value < 65_536.0 else 0.0


def _centimetres(value: float) -> float:
    if not math.isfinite(value):
        return 0.0
    centimetres = int(struct.unpack("<f", struct.pack("<f", value * 100.0))[0])
    return float(struct.unpack("<f", struct.pack("<f", centimetres * 0.01))[0])
