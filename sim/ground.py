"""Leaving the ground and coming back to it: what an autopilot sends then, and when it disarms by itself."""

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.hosts import Announcer, Commandable, Equipment
from skyfolio.sim.navigator import Navigator

CRASH_NOTICED_S = 2.0
"""How long a crashed vehicle lies on the ground until its autopilot notices."""


class GroundHost(Announcer, Equipment, Commandable, Protocol):
    """The vehicle that leaves the ground and lands."""

    navigator: Navigator

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""

    def set_home_here(self) -> None:
        """Make the present place home, and send it."""


class Ground:
    """Watches one vehicle's skids."""

    def __init__(self, host: GroundHost) -> None:
        self._host = host
        self._armed_s = self._landed_s = math.inf

    def armed(self) -> None:
        """Start the time after which a vehicle that never takes off disarms."""
        self._armed_s, self._landed_s = self._host.clock.now_s, math.inf

    def took_off(self) -> None:
        """Report that the vehicle has left the ground (EXTENDED_SYS_STATE, event "takeoff")."""
        host, words = self._host, self._host.traits.words
        host.announce(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        self._landed_s = self._armed_s = math.inf
        if words.took_off:
            host.send_text(words.took_off)
            host.set_home_here()
        host.emit("takeoff", {})

    def touched(self, sinking_mps: float) -> None:
        """Report that the vehicle has met the ground at a vertical speed, m/s (event "landed" or "crashed")."""
        host, words = self._host, self._host.traits.words
        host.announce(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        self._landed_s = host.clock.now_s
        if words.landed and host.armed:
            host.send_text(words.landed)
        if host.dynamics.powered:
            host.navigator.settle()
            host.emit("landed", {})
        else:
            host.dynamics.crashed = True
            host.emit("crashed", {"impact_mps": round(abs(sinking_mps), 2)})

    def disarm_when_idle(self) -> None:
        """Disarm an armed vehicle that has landed, never took off, or lies there broken, once its time has come."""
        host = self._host
        now_s, tuning, words = host.clock.now_s, host.parameters.tuning, host.traits.words
        if host.dynamics.crashed and words.crashed:
            if now_s - self._landed_s >= CRASH_NOTICED_S:
                host.send_text(words.crashed, dialect.MAV_SEVERITY_EMERGENCY)
                host.disarm()
            return
        landing_s, idle_s = tuning.disarm_after_landing_s, tuning.disarm_on_ground_s
        if landing_s is not None and now_s - self._landed_s >= landing_s:
            host.disarm(words=words.disarmed_by_landing)
        elif idle_s is not None and now_s - self._armed_s >= idle_s:
            host.disarm(words=words.disarmed_idle)
