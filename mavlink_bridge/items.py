"""Mission items as MAVLink carries them (MISSION_ITEM_INT), and the mission of one UAV."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from skyfolio.mavlink_bridge.autopilots import DEFAULT_AUTOPILOT, Autopilot

MAX_ITEMS = 200
"""The number of items a mission may have: every common autopilot stores as many."""


class Command(IntEnum):
    """The MAV_CMD values the bridge knows: what the compiler emits, and what a file may bring."""

    NAV_WAYPOINT = 16
    NAV_LOITER_UNLIM = 17
    NAV_LOITER_TIME = 19
    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    NAV_SPLINE_WAYPOINT = 82
    NAV_DELAY = 93
    DO_CHANGE_SPEED = 178
    NAV_FENCE_RETURN_POINT = 5000
    NAV_FENCE_POLYGON_VERTEX_INCLUSION = 5001
    NAV_FENCE_POLYGON_VERTEX_EXCLUSION = 5002
    NAV_FENCE_CIRCLE_INCLUSION = 5003
    NAV_FENCE_CIRCLE_EXCLUSION = 5004
    NAV_RALLY_POINT = 5100


_LAST_NAV = 95
"""MAV_CMD_NAV_LAST: commands up to here are flown, later ones are done on the way."""


class Frame(IntEnum):
    """The MAV_FRAME values the compiler emits."""

    GLOBAL = 0
    """x, y in 1e-7 degrees, z in metres above mean sea level."""
    MISSION = 2
    """No position: x, y, z mean nothing."""
    GLOBAL_RELATIVE_ALT = 3
    """As 6, in files: QGroundControl and Mission Planner write this one."""
    GLOBAL_INT = 5
    """As 0, where setpoints say so."""
    GLOBAL_RELATIVE_ALT_INT = 6
    """x, y in 1e-7 degrees, z in metres above the vehicle's own home."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MissionItem:
    """One MISSION_ITEM_INT (73) of mission type 0.

    `x`, `y` are latitude and longitude in 1e-7 degrees, `z` is metres in the datum of `frame`; the parameters
    mean what `command` (MAV_CMD) says. `current` is 1 for the item the vehicle continues from after an upload.
    """

    seq: int
    frame: int
    command: int
    current: int = 0
    autocontinue: int = 1
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0

    @property
    def has_position(self) -> bool:
        """Return whether x, y, z are a place."""
        return self.frame != Frame.MISSION

    @property
    def is_flown(self) -> bool:
        """Return whether the vehicle flies to complete this item; others (DO_...) are done at once and passed."""
        return self.command <= _LAST_NAV


@dataclass(frozen=True, kw_only=True)
class Mission:
    """What one vehicle is commanded to fly.

    `slot_of_item` maps the seq of each NAV_WAYPOINT to the slot at whose beginning the vehicle should be there.
    `duration_s` is the planned time from the start of slot 0 (airborne: from the swap) to the end of the last slot.
    `start_item` is what a vehicle in the air flies first: the slot-0 waypoint, or the first leg of a swap.
    `autopilot` is the one it was compiled for: each flies different items.
    """

    uav_id: str
    items: tuple[MissionItem, ...]
    slot_of_item: Mapping[int, int]
    duration_s: float
    start_item: int = 0
    autopilot: Autopilot = DEFAULT_AUTOPILOT

    def __post_init__(self) -> None:
        seqs = [item.seq for item in self.items]
        if seqs != list(range(len(seqs))) or not seqs:
            raise ValueError(f"items: seq must run 0, 1, 2... without gaps, not {seqs}")
        if sum(item.current for item in self.items) != 1:
            raise ValueError("items: exactly one item must have current = 1")
        object.__setattr__(self, "slot_of_item", MappingProxyType(dict(self.slot_of_item)))

    def item_of_slot(self, slot: int) -> int:
        """Return the seq of the waypoint where the vehicle is when `slot` begins: the slot's own, or a hold's."""
        reached = [seq for seq, first in self.slot_of_item.items() if first <= slot]
        return max(reached, default=min(self.slot_of_item))
