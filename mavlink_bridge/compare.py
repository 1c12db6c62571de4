"""Is what the vehicle stores what we sent? The proof of an upload is a read-back that compares equal."""

from __future__ import annotations

from collections.abc import Sequence

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.items import MissionItem
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.readback import Kept, kept_of

_DATUM = {5: 0, 6: 3, 11: 10}
"""MAV_FRAME of integer coordinates: the same datum as its older number; autopilots read either back."""
_WHOLE = ("seq", "command")
_RULED = ("param1", "param2", "param3", "param4", "autocontinue")


def mission_differences(
    sent: Sequence[MissionItem],
    read_back: Sequence[MissionItem],
    *,
    autopilot: Autopilot | None = None,
    mission_type: MissionType = MissionType.MISSION,
) -> tuple[str, ...]:
    """What differs from what this autopilot has to give back (`readback`), one sentence each; empty means sound.

    Without an autopilot everything has to be equal, but for the rounding of float32. `current` is the vehicle's own
    state and is not compared, nor are the frame and the coordinates of items that have no place, nor item 0 of an
    ArduPilot's mission, which is its own home.
    """
    if len(sent) != len(read_back):
        return (f"{len(sent)} items sent, {len(read_back)} read back",)
    home_first = autopilot is Autopilot.ARDUPILOT and mission_type is MissionType.MISSION
    pairs = list(zip(sent, read_back, strict=True))[int(home_first) :]
    return tuple(
        text
        for one, other in pairs
        for text in _item_differences(one, other, kept_of(autopilot, mission_type, one.command))
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
