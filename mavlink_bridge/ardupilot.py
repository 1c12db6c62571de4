"""A schedule as ArduCopter mission items.

Item 0 is home: ArduPilot keeps its own place there, whatever is uploaded. Item 1 must be NAV_TAKEOFF on the ground. It
stores a waypoint's hold in whole seconds and neither radius nor yaw (AP_Mission), so none of these is sent, and
altitudes in centimetres. Read back, commands without a place have frame 0.
"""

from __future__ import annotations

from skyfolio.mavlink_bridge.items import Command, Frame
from skyfolio.mavlink_bridge.pace import Point
from skyfolio.mavlink_bridge.schedule import Stop
from skyfolio.mavlink_bridge.writer import MissionWriter


class ArduPilotWriter(MissionWriter):
    """On the ground: home, NAV_TAKEOFF. In flight: home, then straight to the first leg."""

    def _begin(self, first_m: Point, *, takeoff: bool) -> None:
        self.altitude_m = round(self.altitude_m, 2)
        self._position(Command.NAV_WAYPOINT, first_m, 0.0, frame=Frame.GLOBAL)
        if takeoff:
            self._position(Command.NAV_TAKEOFF, first_m, self.altitude_m)

    def _waypoint(self, stop: Stop) -> None:
        self._position(Command.NAV_WAYPOINT, stop.point_m, self.altitude_m, param1=float(round(stop.hold_s)))
