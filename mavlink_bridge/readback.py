"""What an autopilot gives back of what it was sent: one table of autopilot, mission type, command and field.

Storage is smaller than a MISSION_ITEM_INT, so a sound mission does not come back literally. Each field has a rule: it
comes back as it was sent (`SAME`), changed in a known way (`WHOLE`, `DEGREES`, ...), as 0 whatever was sent
(`DROPPED`), or it means nothing (`ANY`). A command that is not in the table has to come back literally.

From the sources: ArduPilot 4.6 `AP_Mission::mavlink_int_to_mission_cmd` and back, `MissionItemProtocol_Fence`,
`AC_PolyFence_loader::write_fence`, `MissionItemProtocol_Rally`; PX4 1.18 `MavlinkMissionManager::
parse_mavlink_mission_item`, `format_mavlink_mission_item` and `send_mission_item`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import fmod, isclose, isnan, trunc
from types import MappingProxyType

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.items import Command
from skyfolio.mavlink_bridge.mission_messages import MissionType

_REL = 2.0**-22
"""Two units in the last place of a float32."""
_ABS = 1e-6


@dataclass(frozen=True, slots=True)
class Rule:
    """What is kept of one value: `kept(sent)`, give or take `within`, or around `full_turn`. None: anything will do."""

    kept: Callable[[float], float] | None
    within: float = _ABS
    full_turn: float | None = None

    def allows(self, sent: float, read: float) -> bool:
        """Whether `read` is what the vehicle makes of `sent`."""
        if self.kept is None:
            return True
        expected = self.kept(sent)
        if isnan(expected) or isnan(read):
            return isnan(expected) and isnan(read)
        if self.full_turn is not None:
            apart = abs(fmod(expected - read, self.full_turn))
            return min(apart, self.full_turn - apart) <= self.within
        return isclose(expected, read, rel_tol=_REL, abs_tol=self.within)


def _whole(sent: float) -> float:
    return sent if isnan(sent) else float(trunc(sent))


def _direction(sent: float) -> float:
    """Only the sign is kept, and nothing is clockwise."""
    return -1.0 if sent < 0.0 else 1.0


SAME = Rule(lambda sent: sent)
DROPPED = Rule(lambda _sent: 0.0)
SET = Rule(lambda _sent: 1.0)
ANY = Rule(None)
WHOLE = Rule(_whole)
"""Cut off to an integer."""
NEAREST = Rule(lambda sent: float(trunc(sent + 0.5)))
FLAG = Rule(lambda sent: 1.0 if sent > 0.0 else 0.0)
DIRECTION = Rule(_direction)
DEGREES = Rule(lambda sent: sent, within=1e-3, full_turn=360.0)
"""Stored in radians from 0 to a full turn."""
CENTIMETRES = Rule(lambda sent: sent, within=0.0101)
"""Cut off to a centimetre, after a multiplication in float32 that may end just below one."""
MILLIMETRES = Rule(lambda sent: sent, within=1.01e-3)
"""Stored as an integer where less than a thousandth is lost."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Kept:
    """What is kept of an item. `placed`: latitude and longitude are; `datum`: what its altitude is measured from is."""

    param1: Rule = SAME
    param2: Rule = SAME
    param3: Rule = SAME
    param4: Rule = SAME
    z: Rule = SAME
    autocontinue: Rule = SAME
    placed: bool = True
    datum: bool = True


LITERALLY = Kept()
_NO_PARAMS = Kept(param1=DROPPED, param2=DROPPED, param3=DROPPED, param4=DROPPED)

_COPTER_ITEM = replace(_NO_PARAMS, z=CENTIMETRES, autocontinue=SET)
_COPTER_ORDER = Kept(param4=DROPPED, autocontinue=SET, placed=False)
_COPTER_FENCE = replace(_NO_PARAMS, z=DROPPED, autocontinue=DROPPED, datum=False)
_COPTER_CIRCLE = replace(_COPTER_FENCE, param1=MILLIMETRES)
_COPTER_CORNER = replace(_COPTER_FENCE, param1=WHOLE)

_PX4_FENCE = replace(_NO_PARAMS, autocontinue=DROPPED, datum=False)
_PX4_CORNER = replace(_PX4_FENCE, param1=NEAREST)
_PX4_CIRCLE = replace(_PX4_FENCE, param1=SAME)

TABLE: Mapping[tuple[Autopilot, MissionType], Mapping[int, Kept]] = MappingProxyType(
    {
        (Autopilot.ARDUPILOT, MissionType.MISSION): {
            Command.NAV_WAYPOINT: replace(_COPTER_ITEM, param1=WHOLE),
            Command.NAV_SPLINE_WAYPOINT: replace(_COPTER_ITEM, param1=WHOLE),
            Command.NAV_LOITER_UNLIM: replace(_COPTER_ITEM, param3=WHOLE),
            Command.NAV_LOITER_TIME: replace(_COPTER_ITEM, param1=WHOLE, param3=DIRECTION, param4=FLAG),
            Command.NAV_RETURN_TO_LAUNCH: replace(_NO_PARAMS, autocontinue=SET, placed=False),
            Command.NAV_LAND: replace(_COPTER_ITEM, param1=WHOLE, param4=DIRECTION),
            Command.NAV_TAKEOFF: replace(_COPTER_ITEM, param1=WHOLE),
            Command.NAV_DELAY: replace(_COPTER_ORDER, param2=WHOLE, param3=WHOLE, param4=WHOLE),
            Command.DO_CHANGE_SPEED: replace(_COPTER_ORDER, param1=WHOLE),
        },
        (Autopilot.ARDUPILOT, MissionType.FENCE): {
            Command.NAV_FENCE_RETURN_POINT: _COPTER_FENCE,
            Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION: _COPTER_CORNER,
            Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION: _COPTER_CORNER,
            Command.NAV_FENCE_CIRCLE_INCLUSION: _COPTER_CIRCLE,
            Command.NAV_FENCE_CIRCLE_EXCLUSION: _COPTER_CIRCLE,
        },
        (Autopilot.ARDUPILOT, MissionType.RALLY): {
            Command.NAV_RALLY_POINT: replace(_NO_PARAMS, z=WHOLE, autocontinue=DROPPED),
        },
        (Autopilot.PX4, MissionType.MISSION): {
            Command.NAV_WAYPOINT: Kept(param3=DROPPED, param4=DEGREES),
            Command.NAV_LOITER_UNLIM: Kept(param1=DROPPED, param2=DROPPED, param4=DEGREES),
            Command.NAV_LOITER_TIME: Kept(param2=FLAG, param4=FLAG),
            Command.NAV_RETURN_TO_LAUNCH: Kept(placed=False),
            Command.NAV_LAND: Kept(param2=WHOLE, param3=DROPPED, param4=DEGREES),
            Command.NAV_TAKEOFF: replace(_NO_PARAMS, param4=DEGREES),
            Command.NAV_DELAY: Kept(placed=False),
            Command.DO_CHANGE_SPEED: Kept(placed=False),
        },
        (Autopilot.PX4, MissionType.FENCE): {
            Command.NAV_FENCE_RETURN_POINT: _PX4_FENCE,
            Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION: _PX4_CORNER,
            Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION: _PX4_CORNER,
            Command.NAV_FENCE_CIRCLE_INCLUSION: _PX4_CIRCLE,
            Command.NAV_FENCE_CIRCLE_EXCLUSION: _PX4_CIRCLE,
        },
        (Autopilot.PX4, MissionType.RALLY): {Command.NAV_RALLY_POINT: _NO_PARAMS},
    }
)


def kept_of(autopilot: Autopilot | None, mission_type: MissionType, command: int) -> Kept:
    """The row of a command; None for the autopilot: a file, which keeps everything."""
    if autopilot is None:
        return LITERALLY
    return TABLE[autopilot, mission_type].get(command, LITERALLY)
