"""End positions to which no paths were found: an error that names what is in the way. Loads no optimiser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Blocked:
    """What stands in the way of an end position, for UAVs by their index.

    `zones` or `energy` of one, each `other` of two, the `ground` of some, or all together.
    """

    by: Literal["zones", "energy", "other", "fleet", "ground"]
    uavs: tuple[int, ...] = ()


class UnreachableEndError(ValueError):
    """No paths were found that bring every UAV to its `end_m` by its last slot; `blocked` says what stands in the way.

    The message names UAVs by index until `named` puts in their ids.
    """

    def __init__(self, blocked: Blocked, ids: tuple[str, ...] | None = None) -> None:
        self.blocked = blocked
        super().__init__(_words(blocked, ids))

    def named(self, ids: tuple[str, ...]) -> UnreachableEndError:
        """Return the same error with the ids of the UAVs, in planning order, in its message."""
        return UnreachableEndError(self.blocked, ids)


def _words(blocked: Blocked, ids: tuple[str, ...] | None) -> str:
    who = [f"UAV {u}" if ids is None else f"'{ids[u]}'" for u in blocked.uavs]
    if blocked.by == "zones":
        (u,) = blocked.uavs
        return f"uavs.{u}.end_m: {who[0]} finds no way around the no_fly zones to its end by its last slot"
    if blocked.by == "ground":
        return (
            f"terrain: no path was found on which {', '.join(who)} keeps clear of the ground, also on the way home, "
            "within its climb rate, altitude_max_m and battery, and reaches its end or keeps its pinned path"
        )
    if blocked.by == "energy":
        (u,) = blocked.uavs
        return (
            f"uavs.{u}.battery: {who[0]} finds no way to its end_m by its last slot on which it could always come home "
            "with its reserve"
        )
    if blocked.by == "other":
        a, b = blocked.uavs
        return (
            f"uavs.{a}.end_m, uavs.{b}.end_m: {who[0]} and {who[1]} find no way past each other to their ends at "
            "min_separation_m, within area_m and by their last slots (eqs. 6d-6f)"
        )
    return "uavs: no paths found that bring every UAV to its end_m in time, although every two alone find theirs"
