"""Leaving the ground and coming back to it: what an autopilot says then, and when it disarms by itself."""

import math
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

CRASH_NOTICED_S = 2.0
"""How long it lies there until an autopilot knows."""


class Ground:
    """Watches one vehicle's skids."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._armed_s = self._landed_s = math.inf

    def armed(self) -> None:
        """Hear that it was armed."""
        self._armed_s, self._landed_s = self._autopilot.now_s, math.inf

    def notice(self, sinking_mps: float, *, took_off: bool) -> None:
        """Hear that it has left the ground, or met it, sinking so fast."""
        autopilot = self._autopilot
        autopilot.announce(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        words = autopilot.flavour.words
        if took_off:
            self._landed_s = self._armed_s = math.inf
            if words.took_off:
                autopilot.say(words.took_off)
                autopilot.set_home_here()
            autopilot.emit("takeoff", {})
            return
        self._landed_s = autopilot.now_s
        if words.landed and autopilot.armed:
            autopilot.say(words.landed)
        if autopilot.dynamics.powered:
            autopilot.navigator.settle()
            autopilot.emit("landed", {})
        else:
            autopilot.dynamics.crashed = True
            autopilot.emit("crashed", {"impact_mps": round(abs(sinking_mps), 2)})

    def disarm_when_idle(self) -> None:
        """Disarm what has landed, never took off, or lies there broken, when its time has come."""
        autopilot = self._autopilot
        if not autopilot.armed:
            return
        tuning, words = autopilot.parameters.tuning, autopilot.flavour.words
        if autopilot.crashed and words.crashed:
            if autopilot.now_s - self._landed_s >= CRASH_NOTICED_S:
                autopilot.say(words.crashed, dialect.MAV_SEVERITY_EMERGENCY)
                autopilot.disarm()
            return
        waits = ((self._landed_s, tuning.disarm_after_landing_s), (self._armed_s, tuning.disarm_on_ground_s))
        if any(wait_s is not None and autopilot.now_s - since_s >= wait_s for since_s, wait_s in waits):
            autopilot.disarm(words=words.disarmed_by_landing)
