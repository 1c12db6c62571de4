"""PX4's failsafes (commander/failsafe of 1.18): first Hold for COM_FAIL_ACT_T, then what the parameter says.

A failsafe is over when a mode is chosen, or with the flight; it does not resume what it interrupted, except that
OFFBOARD goes on when the setpoints are back. Without a position there is no Hold: it descends at once (shown as LAND).
"""

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.failsafes import SEVERITY, FailsafeHost, Failsafes
from skyfolio.sim.geofence import Fence
from skyfolio.sim.modes import Mode
from skyfolio.sim.tuning import Action, Breach, LowBattery

_CRITICAL = dialect.MAV_SEVERITY_CRITICAL
_DELAYED = (Action.RETURN, Action.LAND)
_BREACHES = {
    Breach.CEILING: "Geofence: exceeding maximum altitude above Home",
    Breach.RADIUS: "Geofence: exceeding maximum distance to Home",
    Breach.SHAPES: "Geofence: approaching or outside geofence",
}


class Px4Failsafes(Failsafes):
    """The failsafes of a PX4."""

    position_loss_s = 5.0  # recorded: GPS off to descending

    def __init__(self, host: FailsafeHost, fence: Fence) -> None:
        super().__init__(host, fence)
        self._doing = Action.NONE
        self._next: tuple[float, Action, str] | None = None
        self._left_offboard = False

    @property
    def active(self) -> bool:
        """Whether a failsafe is flying the vehicle."""
        return self._doing is not Action.NONE

    def taken_over(self) -> None:
        """Forget every failsafe: the vehicle is flown in the mode that was chosen."""
        self._doing, self._next, self._left_offboard = Action.NONE, None, False

    def disarmed(self) -> None:
        """Forget every failsafe: the flight is over."""
        self.taken_over()

    def check(self, now_s: float, wall_s: float) -> None:
        """Act on what has failed, and on what was delayed until now."""
        super().check(now_s, wall_s)
        self._check_setpoints(now_s)
        if self._next is not None and now_s >= self._next[0]:
            _, action, cause = self._next
            self._next = None
            self._enter(action, cause)

    def _check_setpoints(self, now_s: float) -> None:
        """Leave OFFBOARD when the setpoints stop."""
        host, tuning = self._host, self._host.parameters.tuning
        setpoint = host.navigator.setpoint
        fresh = setpoint is not None and now_s - setpoint.at_s <= tuning.setpoint_timeout_s
        if self._left_offboard and fresh and self._doing is tuning.setpoint_loss:
            host.set_mode(Mode.GUIDED)
        elif host.mode is Mode.GUIDED and not fresh and host.armed:
            self._trigger(tuning.setpoint_loss, "setpoints_lost", delayed=False)
            self._left_offboard = self.active

    def _link_is_lost(self) -> None:
        self._host.send_text("Connection to ground station lost\t")
        self._trigger(self._host.parameters.tuning.link_loss.action, "gcs_lost")

    def _link_is_back(self) -> None:
        self._host.send_text("GCS connection regained\t")

    def _battery_fell(self, levels: tuple[LowBattery, ...]) -> None:
        self._host.send_text(levels[0].words, levels[0].severity)
        if levels[-1].last:
            self._host.send_text("System does not support shutdown\t", _CRITICAL)
        self._trigger(levels[-1].action, "battery")

    def _position_is_lost(self) -> None:
        if self._host.mode.needs_position:
            self._trigger(Action.LAND, "position_lost", delayed=False)

    def _position_is_back(self) -> None:
        """Keep descending: a failsafe does not resume."""

    def _fence_is_broken(self, breach: Breach) -> None:
        self._host.send_text(_BREACHES[breach], _CRITICAL)
        self._trigger(self._host.parameters.tuning.fence.action, "fence")

    def _fence_is_whole(self) -> None:
        """Send nothing."""

    def _trigger(self, action: Action, cause: str, *, delayed: bool = True) -> None:
        if action in (Action.NONE, Action.WARN) or not self._flying or self._milder_than_now(action):
            return
        pending = self._next[1] if self._next else self._doing
        if SEVERITY.index(action) <= SEVERITY.index(pending):
            return
        delay_s = self._host.parameters.tuning.failsafe_delay_s
        hold_first = delayed and action in _DELAYED and self._doing in (Action.NONE, Action.HOLD) and delay_s > 0.0
        if not hold_first or not self._host.satellites:
            self._next = None
            self._enter(action, cause)
            return
        if self._next is None:
            words = f"Failsafe activated: entering Hold for {math.floor(delay_s + 0.5)} seconds\t"
            self._host.send_text(words, _CRITICAL)
            self._doing = Action.HOLD
            self._act(Action.HOLD, cause)
        due_s = self._next[0] if self._next else self._host.clock.now_s + delay_s
        self._next = (due_s, action, cause)

    def _enter(self, action: Action, cause: str) -> None:
        self._host.send_text("Failsafe activated\t", _CRITICAL)
        self._doing = action
        self._act(action, cause)
