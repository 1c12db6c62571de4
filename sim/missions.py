"""A plan on board (mission, fence or rally points): its items, and which of them are acceptable."""

import math
import struct
import zlib
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

MIN_VERTICES = 3
MAX_HOLD_S = 65_536.0
MAX_FENCE_M = 100_000.0
NOT_GIVEN = 0x7FFFFFFF
"""INT32_MAX in x or y: the coordinate is left to the vehicle (MAVLink's NaN for integers)."""

NAV_COMMANDS = frozenset(
    {
        dialect.MAV_CMD_NAV_WAYPOINT,
        dialect.MAV_CMD_NAV_LOITER_UNLIM,
        dialect.MAV_CMD_NAV_LOITER_TIME,
        dialect.MAV_CMD_NAV_DELAY,
        dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        dialect.MAV_CMD_NAV_LAND,
        dialect.MAV_CMD_NAV_TAKEOFF,
    }
)
COMMANDS = NAV_COMMANDS | {dialect.MAV_CMD_DO_CHANGE_SPEED}
RELATIVE_FRAMES = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
ABSOLUTE_FRAMES = (dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT)
_TIMED = (dialect.MAV_CMD_NAV_WAYPOINT, dialect.MAV_CMD_NAV_LOITER_TIME, dialect.MAV_CMD_NAV_DELAY)
_PLACELESS = (dialect.MAV_CMD_DO_CHANGE_SPEED, dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH, dialect.MAV_CMD_NAV_DELAY)
FENCE_POLYGONS = (
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
FENCE_CIRCLES = (dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)
COMMANDS_OF = {
    dialect.MAV_MISSION_TYPE_MISSION: COMMANDS,
    dialect.MAV_MISSION_TYPE_FENCE: frozenset(
        {dialect.MAV_CMD_NAV_FENCE_RETURN_POINT, *FENCE_POLYGONS, *FENCE_CIRCLES}
    ),
    dialect.MAV_MISSION_TYPE_RALLY: frozenset({dialect.MAV_CMD_NAV_RALLY_POINT}),
}
"""What each MAV_MISSION_TYPE may hold."""


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One MISSION_ITEM_INT: x and y in 1e-7 degrees, z in metres above the level of `frame` (MAV_FRAME)."""

    seq: int
    frame: int
    command: int
    current: int
    autocontinue: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float

    @classmethod
    def from_message(cls, message: Any) -> "MissionItem":
        """Return the item a MISSION_ITEM_INT carries."""
        return cls(*(getattr(message, name) for name in cls.__slots__))

    @classmethod
    def from_float_message(cls, message: Any) -> "MissionItem":
        """Return the item a MISSION_ITEM carries; its degrees are floats, about 0.2 m coarse."""
        values = {name: getattr(message, name) for name in cls.__slots__}
        for name, limit in (("x", 90.0), ("y", 180.0)):
            degrees = values[name]
            values[name] = round(degrees * 1e7) if abs(degrees) <= limit else NOT_GIVEN
        return cls(**values)

    @property
    def fingerprint(self) -> bytes:
        """All fields that matter to the flight, comparable even with NaN; `current`, a cursor, is left out."""
        head = (self.seq, self.frame, self.command, self.autocontinue, self.param1, self.param2, self.param3)
        return struct.pack("<HBHB4fiif", *head, self.param4, self.x, self.y, self.z)

    @property
    def is_nav(self) -> bool:
        """Whether the vehicle has to fly to complete this item; any other is done at once."""
        return self.command in NAV_COMMANDS

    @property
    def has_place(self) -> bool:
        """Whether latitude and longitude are given; for takeoff, land and loiter (0, 0) also means "here"."""
        if self.command in _PLACELESS or NOT_GIVEN in (self.x, self.y):
            return False
        return self.command == dialect.MAV_CMD_NAV_WAYPOINT or (self.x, self.y) != (0, 0)

    def relative_alt_m(self, home_alt_m: float) -> float:
        """Return z as metres above home."""
        return self.z if self.frame in RELATIVE_FRAMES else self.z - home_alt_m


@dataclass(frozen=True, slots=True)
class Mission:
    """A complete plan; `mission_id` is the CRC-32 of its items, 0 when there are none."""

    items: tuple[MissionItem, ...] = ()
    mission_id: int = field(init=False)

    def __post_init__(self) -> None:
        crc = 0
        for item in self.items:
            crc = zlib.crc32(item.fingerprint, crc)
        object.__setattr__(self, "mission_id", crc)

    def __len__(self) -> int:
        return len(self.items)

    @property
    def marked_current(self) -> int | None:
        """The first item uploaded with current = 1, or None."""
        return next((item.seq for item in self.items if item.current), None)


def rejection(item: MissionItem, mission_type: int = dialect.MAV_MISSION_TYPE_MISSION) -> int | None:
    """Return the MAV_MISSION_RESULT that refuses this item in a plan of this type, or None if it can be used."""
    if item.command not in COMMANDS_OF[mission_type]:
        return int(dialect.MAV_MISSION_UNSUPPORTED)
    allowed_frames = {*RELATIVE_FRAMES, *ABSOLUTE_FRAMES}
    if item.command in _PLACELESS:
        allowed_frames.add(dialect.MAV_FRAME_MISSION)
    if item.frame not in allowed_frames:
        return int(dialect.MAV_MISSION_UNSUPPORTED_FRAME)
    bad = _bad_parameter(item)
    return _bad_place(item) if bad is None else bad


def bad_fence(items: tuple[MissionItem, ...]) -> bool:
    """Return whether a fence is malformed.

    A polygon is a run of at least 3 vertices, each with their number in param1.
    """
    at = 0
    while at < len(items):
        item = items[at]
        run = int(item.param1) if item.command in FENCE_POLYGONS else 1
        group = items[at : at + run]
        if item.command in FENCE_POLYGONS and (run < MIN_VERTICES or len(group) < run):
            return True
        if any((other.command, other.param1) != (item.command, item.param1) for other in group):
            return True
        at += run
    return False


def _bad_parameter(item: MissionItem) -> int | None:
    if item.command == dialect.MAV_CMD_DO_CHANGE_SPEED:
        usable = item.param2 > 0.0 or item.param2 in (-1.0, -2.0)
        return None if usable and math.isfinite(item.param2) else int(dialect.MAV_MISSION_INVALID_PARAM2)
    if item.command in _TIMED and not 0.0 <= item.param1 < MAX_HOLD_S:
        relative = item.command != dialect.MAV_CMD_NAV_DELAY
        return int(dialect.MAV_MISSION_INVALID_PARAM1) if relative or item.param1 != -1.0 else None
    if item.command == dialect.MAV_CMD_NAV_WAYPOINT:
        if not 0.0 <= item.param2 < math.inf:
            return int(dialect.MAV_MISSION_INVALID_PARAM2)
        if not item.has_place:
            return int(dialect.MAV_MISSION_INVALID_PARAM5_X)
    if item.command in (*FENCE_POLYGONS, *FENCE_CIRCLES) and not 0.0 < item.param1 < MAX_FENCE_M:
        return int(dialect.MAV_MISSION_INVALID_PARAM1)
    return None


def _bad_place(item: MissionItem) -> int | None:
    if item.has_place:
        if abs(item.x) > 90 * 10**7:
            return int(dialect.MAV_MISSION_INVALID_PARAM5_X)
        if abs(item.y) > 180 * 10**7:
            return int(dialect.MAV_MISSION_INVALID_PARAM6_Y)
    if item.command not in _PLACELESS and not math.isfinite(item.z):
        return int(dialect.MAV_MISSION_INVALID_PARAM7)
    return None
