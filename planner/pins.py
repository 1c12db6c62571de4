"""Pins: parts of a plan that a request fixes beforehand. `pinning.py` checks them and makes arrays of them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from skyfolio.planner.scenario import Frozen, Identifier, Point


class Pins(Frozen):
    """What a plan is held to, by ids; all of it optional.

    paths_m: where a UAV is when each slot begins, metres east/north, from its start on: one point for each slot of the
    plan, or for each slot in which the UAV flies. uavs: these keep the path they are on: in a replan the rest of the
    previous plan's path, caught up with at full speed from where the UAV is; in a plan they hover at their start.
    associations: who serves a user, in all slots or slot by slot, null where that is free; whether the user is given
    any bandwidth stays open. In a replan slots are counted from its first one.
    """

    paths_m: Annotated[dict[Identifier, tuple[Point, ...]], Field(max_length=1000)] = Field(default_factory=dict)
    uavs: Annotated[tuple[Identifier, ...], Field(max_length=1000)] = ()
    associations: dict[Identifier, Identifier | tuple[Identifier | None, ...]] = Field(default_factory=dict)

    def __bool__(self) -> bool:
        """Return whether anything is pinned."""
        return bool(self.paths_m or self.uavs or self.associations)

    @property
    def pinned_uavs(self) -> tuple[str, ...]:
        """The UAVs whose paths are fixed."""
        return (*self.paths_m, *(uav for uav in self.uavs if uav not in self.paths_m))


class DroppedPin(Frozen):
    """A pin of the previous plan that a replan could not keep, and why.

    kind: a UAV's `path` or a user's `association`. id: of that UAV or user. slots: in how many slots of the replan it
    is free now.
    """

    kind: Literal["path", "association"]
    id: str
    slots: int
    reason: str
