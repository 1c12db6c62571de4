"""Is what the vehicle stores what we sent? The proof of an upload is a read-back that compares equal."""

from __future__ import annotations

from collections.abc import Sequence
from math import isclose, isnan

from mavlink_bridge.items import MissionItem

_REL = 2.0**-22
"""Two units in the last place of a float32."""
_ABS = 1e-6
_DATUM = {5: 0, 6: 3, 11: 10}
"""MAV_FRAME of integer coordinates: the same datum as its older number, which is what ArduPilot reads back."""


def mission_differences(
    sent: Sequence[MissionItem], read_back: Sequence[MissionItem], *, home_first: bool = False
) -> tuple[str, ...]:
    """What differs, one sentence each; empty means equal.

    Integers (seq, frame, command, autocontinue, x, y) must be equal; parameters and altitude travel as float32 and
    may differ by its rounding. `current` is the vehicle's own state and is not compared; neither are the frame and
    the coordinates of items that have no position. `home_first`: item 0 is home, where ArduPilot keeps its own place,
    and is not compared either.
    """
    if len(sent) != len(read_back):
        return (f"{len(sent)} items sent, {len(read_back)} read back",)
    pairs = list(zip(sent, read_back, strict=True))[int(home_first) :]
    return tuple(text for one, other in pairs for text in _item_differences(one, other))


def _item_differences(sent: MissionItem, read: MissionItem) -> list[str]:
    integers = ["seq", "command", "autocontinue"]
    floats = ["param1", "param2", "param3", "param4"]
    if sent.has_position:
        integers += ["x", "y"]
        floats += ["z"]
    different = [name for name in integers if getattr(sent, name) != getattr(read, name)]
    if sent.has_position and _DATUM.get(sent.frame, sent.frame) != _DATUM.get(read.frame, read.frame):
        different.append("frame")
    different += [name for name in floats if not _same(getattr(sent, name), getattr(read, name))]
    return [
        f"item {sent.seq}: {name} {getattr(sent, name)} sent, {getattr(read, name)} read back" for name in different
    ]


def _same(sent: float, read: float) -> bool:
    return (isnan(sent) and isnan(read)) or isclose(sent, read, rel_tol=_REL, abs_tol=_ABS)
