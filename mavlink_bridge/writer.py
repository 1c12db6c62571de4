"""What the writers of all autopilots share: items with gapless seq, speeds only where they change, the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from math import isclose

from skyfolio.mavlink_bridge.e7 import to_e7
from skyfolio.mavlink_bridge.items import Command, Frame, MissionItem
from skyfolio.mavlink_bridge.schedule import Schedule, Stop
from skyfolio.planner.geometry import Point

_GROUND_SPEED = 1.0
_THROTTLE_UNCHANGED = -1.0
_SAME_SPEED = 0.002
"""Relative: 2 cm on a leg of 10 m are not worth an item."""


class OnEnd(StrEnum):
    """What a vehicle does after its last slot."""

    LAND = "land"
    """NAV_LAND where it is: vertical descents keep the separation of the plan."""
    RETURN = "return"
    """NAV_RETURN_TO_LAUNCH: check the ways home with `check_return_paths` first."""
    HOLD = "hold"
    """NAV_LOITER_UNLIM: hover until the next command."""


@dataclass(kw_only=True)
class MissionWriter:
    """Collects the items of one mission; `to_geodetic` turns east/north metres into (lat, lon) degrees.

    A subclass defines the beginning of a mission (`_begin`) and a waypoint (`_waypoint`) for its autopilot.
    `start_item` is the first item a vehicle in the air flies. `frame`: of places; `ground_m`: the ground where the
    mission ends, in its datum.
    """

    frame: Frame
    ground_m: float
    to_geodetic: Callable[[Point], tuple[float, float]]
    items: list[MissionItem] = field(default_factory=list)
    slot_of_item: dict[int, int] = field(default_factory=dict)
    start_item: int = 0
    _speed_mps: float | None = None

    def write(self, schedule: Schedule, *, takeoff: bool, on_end: OnEnd) -> None:
        """Write a whole mission: the beginning, then for each stop its speed and waypoint, then the end."""
        self._begin(schedule.stops[0], takeoff=takeoff)
        self.start_item = len(self.items)
        for number, stop in enumerate(schedule.stops):
            leg = schedule.leg_to(number)
            if leg is not None:
                self._speed(leg.speed_mps)
            self.slot_of_item[len(self.items)] = stop.slot
            self._waypoint(stop)
            if leg is None and stop.hold_s == 0 and len(schedule.stops) > 1:
                self.start_item = len(self.items)  # it hovers there already
        self._end(schedule.stops[-1], on_end)

    def _begin(self, first: Stop, *, takeoff: bool) -> None:
        raise NotImplementedError

    def _waypoint(self, stop: Stop) -> None:
        raise NotImplementedError

    def _speed(self, speed_mps: float) -> None:
        if self._speed_mps is None or not isclose(speed_mps, self._speed_mps, rel_tol=_SAME_SPEED):
            self._speed_mps = round(speed_mps, 3)
            self._command(Command.DO_CHANGE_SPEED, _GROUND_SPEED, self._speed_mps, _THROTTLE_UNCHANGED)

    def _end(self, last: Stop, on_end: OnEnd) -> None:
        if on_end is OnEnd.LAND:
            self._position(Command.NAV_LAND, last.point_m, self.ground_m)
        elif on_end is OnEnd.RETURN:
            self._command(Command.NAV_RETURN_TO_LAUNCH)
        else:
            self._position(Command.NAV_LOITER_UNLIM, last.point_m, self._level(last))

    def _level(self, stop: Stop) -> float:
        """Return the altitude to send for a stop."""
        return stop.altitude_m

    def _position(
        self,
        command: Command,
        point_m: Point,
        altitude_m: float,
        *,
        param1: float = 0.0,
        param2: float = 0.0,
        frame: Frame | None = None,
    ) -> None:
        lat_deg, lon_deg = self.to_geodetic(point_m)
        self._add(
            MissionItem(
                seq=len(self.items),
                frame=self.frame if frame is None else frame,
                command=command,
                current=int(not self.items),
                param1=param1,
                param2=param2,
                x=to_e7(lat_deg),
                y=to_e7(lon_deg),
                z=altitude_m,
            )
        )

    def _command(self, command: Command, param1: float = 0.0, param2: float = 0.0, param3: float = 0.0) -> None:
        self._add(
            MissionItem(
                seq=len(self.items),
                frame=Frame.MISSION,
                command=command,
                current=int(not self.items),
                param1=param1,
                param2=param2,
                param3=param3,
            )
        )

    def _add(self, item: MissionItem) -> None:
        self.items.append(item)
