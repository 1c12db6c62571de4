"""Guidance by streamed setpoints: position and velocity of the plan at this moment, for tight synchrony. Pure.

SET_POSITION_TARGET_GLOBAL_INT (86) with position (frame 6; over terrain 5, above mean sea level) and velocity, at least
5 times a second, is followed by ArduCopter in GUIDED and by PX4 in OFFBOARD. PX4 wants the stream to run before it
changes into the mode.
"""

from __future__ import annotations

from collections.abc import Callable

from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.mavlink_bridge.e7 import to_e7
from skyfolio.mavlink_bridge.mission_messages import AUTOPILOT_COMPONENT, Message
from skyfolio.mavlink_bridge.route import Route
from skyfolio.planner.geometry import Point

RATE_HZ = 10.0
"""ArduCopter followed within 2 m at 5 Hz and within 4.4 m at 2 Hz; 10 leaves room for lost messages."""
LEAD_S = 0.1
"""Setpoints are this far ahead of the clock: the link, and half of the time until the next one."""
_ACCELERATION_YAW_RATE = 0b1001_1100_0000
"""type_mask: ignore acceleration and yaw rate; yaw is used, fixed to north as in missions."""


class Streamer:
    """Makes the setpoints of one UAV. `to_geodetic` turns east/north metres into (lat, lon) degrees."""

    def __init__(
        self,
        system_id: int,
        path_m: list[Point],
        slot_s: float,
        altitudes: Altitudes,
        to_geodetic: Callable[[Point], tuple[float, float]],
    ) -> None:
        self.route = Route(path_m, slot_s)
        self._system_id, self._altitudes, self._to_geodetic = system_id, altitudes, to_geodetic

    def setpoint(self, elapsed_s: float, boot_ms: int = 0) -> Message:
        """Return the message to send `elapsed_s` fleet seconds after slot 0 began (before: that of the first point)."""
        at_s = elapsed_s + LEAD_S if elapsed_s >= 0 else elapsed_s
        planned, slots = self.route.at(at_s), at_s / self.route.slot_s
        lat_deg, lon_deg = self._to_geodetic(planned.point_m)
        east, north = planned.velocity_mps
        return Message(
            "SET_POSITION_TARGET_GLOBAL_INT",
            {
                "time_boot_ms": boot_ms,
                "target_system": self._system_id,
                "target_component": AUTOPILOT_COMPONENT,
                "coordinate_frame": int(self._altitudes.setpoint_frame),
                "type_mask": _ACCELERATION_YAW_RATE,
                "lat_int": to_e7(lat_deg),
                "lon_int": to_e7(lon_deg),
                "alt": self._altitudes.at(slots),
                "vx": north,
                "vy": east,
                "vz": 0.0 - self._altitudes.climb_m(slots) / self.route.slot_s,
                "afx": 0.0,
                "afy": 0.0,
                "afz": 0.0,
                "yaw": 0.0,
                "yaw_rate": 0.0,
            },
        )
