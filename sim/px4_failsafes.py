"""PX4's failsafes (commander/failsafe of 1.18): first Hold for COM_FAIL_ACT_T, then what the parameter says.

A failsafe is over when somebody chooses a mode, or with the flight; it does not resume what it interrupted, except that
OFFBOARD goes on when the setpoints are back. Without a position there is no Hold: it descends at once (shown as LAND).
"""

import math
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.failsafes import SEVERITY, Failsafes
from skyfolio.sim.modes import Mode
from skyfolio.sim.tuning import Action, Breach, LowBattery

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

_CRITICAL = dialect.MAV_SEVERITY_CRITICAL
_DELAYED = (Action.RETURN, Action.LAND)
_BREACHES = {
    Breach.CEILING: "Geofence: exceeding maximum altitude above Home",
    Breach.RADIUS: "Geofence: exceeding maximum distance to Home",
    Breach.SHAPES: "Geofence: approaching or outside geofence",
}


class Px4Failsafes(Failsafes):
    """One PX4's."""

    position_loss_s = 5.0  # recorded: GPS off to descending

    def __init__(self, autopilot: "Autopilot") -> None:
        super().__init__(autopilot)
        self._doing = Action.NONE
        self._next: tuple[float, Action, str] | None = None
        self._left_offboard = False

    @property
    def active(self) -> bool:
        """Whether a failsafe has the vehicle."""
        return self._doing is not Action.NONE

    def taken_over(self) -> None:
        """Let whoever chose a mode have the vehicle."""
        self._doing, self._next, self._left_offboard = Action.NONE, None, False

    def disarmed(self) -> None:
        """Be done with the flight."""
        self.taken_over()

    def check(self, now_s: float, wall_s: float) -> None:
        """Let the failsafes act that are due."""
        super().check(now_s, wall_s)
        self._check_setpoints(now_s)
        if self._next is not None and now_s >= self._next[0]:
            _, action, cause = self._next
            self._next = None
            self._enter(action, cause)

    def _check_setpoints(self, now_s: float) -> None:
        """Leave OFFBOARD when nobody streams any more."""
        autopilot, tuning = self._autopilot, self._autopilot.parameters.tuning
        setpoint = autopilot.navigator.setpoint
        fresh = setpoint is not None and now_s - setpoint.at_s <= tuning.setpoint_timeout_s
        if self._left_offboard and fresh and self._doing is tuning.setpoint_loss:
            autopilot.set_mode(Mode.GUIDED)
        elif autopilot.mode is Mode.GUIDED and not fresh and autopilot.armed:
            self._trigger(tuning.setpoint_loss, "setpoints_lost", delayed=False)
            self._left_offboard = self.active

    def _link_is_lost(self) -> None:
        self._autopilot.say("Connection to ground station lost\t")
        self._trigger(self._autopilot.parameters.tuning.link_loss.action, "gcs_lost")

    def _link_is_back(self) -> None:
        self._autopilot.say("GCS connection regained\t")

    def _battery_fell(self, levels: tuple[LowBattery, ...]) -> None:
        self._autopilot.say(levels[0].words, levels[0].severity)
        if levels[-1].last:
            self._autopilot.say("System does not support shutdown\t", _CRITICAL)
        self._trigger(levels[-1].action, "battery")

    def _position_is_lost(self) -> None:
        if self._autopilot.mode.needs_position:
            self._trigger(Action.LAND, "position_lost", delayed=False)

    def _position_is_back(self) -> None:
        """Keep descending: a failsafe does not resume."""

    def _fence_is_broken(self, breach: Breach) -> None:
        self._autopilot.say(_BREACHES[breach], _CRITICAL)
        self._trigger(self._autopilot.parameters.tuning.fence.action, "fence")

    def _fence_is_whole(self) -> None:
        """Say nothing."""

    def _trigger(self, action: Action, cause: str, *, delayed: bool = True) -> None:
        if action in (Action.NONE, Action.WARN) or not self._flying or self._milder_than_now(action):
            return
        pending = self._next[1] if self._next else self._doing
        if SEVERITY.index(action) <= SEVERITY.index(pending):
            return
        delay_s = self._autopilot.parameters.tuning.failsafe_delay_s
        hold_first = delayed and action in _DELAYED and self._doing in (Action.NONE, Action.HOLD) and delay_s > 0.0
        if not hold_first or not self._autopilot.satellites:
            self._next = None
            self._enter(action, cause)
            return
        if self._next is None:
            words = f"Failsafe activated: entering Hold for {math.floor(delay_s + 0.5)} seconds\t"
            self._autopilot.say(words, _CRITICAL)
            self._doing = Action.HOLD
            self._act(Action.HOLD, cause)
        due_s = self._next[0] if self._next else self._autopilot.now_s + delay_s
        self._next = (due_s, action, cause)

    def _enter(self, action: Action, cause: str) -> None:
        self._autopilot.say("Failsafe activated\t", _CRITICAL)
        self._doing = action
        self._act(action, cause)
