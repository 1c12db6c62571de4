"""A schedule as PX4 mission items.

PX4 wants positions in frame 6, commands without a position in frame 2 (MAV_FRAME_MISSION), the speed of a leg before
the waypoint the leg ends at, and hovering as param1 of the waypoint (a NAV_DELAY item makes copters pace about).
Yaw is fixed to north (param4 = 0): the antenna of a base station keeps its orientation.
"""

from __future__ import annotations

from skyfolio.mavlink_bridge.items import Command
from skyfolio.mavlink_bridge.pace import Point
from skyfolio.mavlink_bridge.schedule import Stop
from skyfolio.mavlink_bridge.writer import MissionWriter


class Px4Writer(MissionWriter):
    """On the ground: NAV_TAKEOFF is item 0. In flight: straight to the first leg."""

    def _begin(self, first_m: Point, *, takeoff: bool) -> None:
        if takeoff:
            self._position(Command.NAV_TAKEOFF, first_m, self.altitude_m)

    def _waypoint(self, stop: Stop) -> None:
        self._position(
            Command.NAV_WAYPOINT,
            stop.point_m,
            self.altitude_m,
            param1=round(stop.hold_s, 3),
            param2=round(stop.radius_m, 3),
        )
