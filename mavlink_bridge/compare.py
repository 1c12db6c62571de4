"""Compare what a vehicle stores with what it was sent: an upload is proven by a read-back that compares equal."""

from __future__ import annotations

from collections.abc import Sequence

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.items import MissionItem
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.readback import LITERALLY, Kept

_DATUM = {5: 0, 6: 3, 11: 10}
"""MAV_FRAME with integer coordinates: the same datum as the older number; autopilots send either back."""
_WHOLE = ("seq", "command")
_RULED = ("param1", "param2", "param3", "param4", "autocontinue")


def mission_differences(
    sent: Sequence[MissionItem],
    read_back: Sequence[MissionItem],
    *,
    autopilot: Autopilot | None = None,
    mission_type: MissionType = MissionType.MISSION,
) -> tuple[str, ...]:
    """Return what differs from what this autopilot has to send back, one text for each field; empty means sound.

    Without an autopilot everything has to be equal, but for the rounding of float32. `current` is the vehicle's own
    state and is not compared, nor are the frame and the coordinates of items that have no place, nor item 0 of a
    mission where that is the vehicle's own home. Raises UnknownAutopilot.
    """
    if len(sent) != len(read_back):
        return (f"{len(sent)} items sent, {len(read_back)} read back",)
    profile = None if autopilot is None else profile_of(autopilot)
    home_first = profile is not None and profile.home_first and mission_type is MissionType.MISSION
    pairs = list(zip(sent, read_back, strict=True))[int(home_first) :]
    return tuple(
        text
        for item, stored in pairs
        for text in _item_differences(
            item, stored, LITERALLY if profile is None else profile.kept_of(mission_type, item.command)
        )
    )


def _item_differences(sent: MissionItem, read: MissionItem, kept: Kept) -> list[str]:
    different = [name for name in _WHOLE if getattr(sent, name) != getattr(read, name)]
    ruled = [*_RULED]
    if sent.has_position and kept.placed:
        ruled.append("z")
        different += [name for name in ("x", "y") if getattr(sent, name) != getattr(read, name)]
        if kept.datum and _DATUM.get(sent.frame, sent.frame) != _DATUM.get(read.frame, read.frame):
            different.append("frame")
    different += [name for name in ruled if not getattr(kept, name).allows(getattr(sent, name), getattr(read, name))]
    return [
        f"item {sent.seq}: {name} {getattr(sent, name)} sent, {getattr(read, name)} read back" for name in different
    ]
