"""The vehicle's own failsafes: ground station gone, battery low, position lost, fence broken, setpoints gone.

Each acts once when its condition begins, in the air and armed only, and never makes things milder: a vehicle that
lands does not return because of a lesser failure. What they do is decided by parameters (`sim.tuning`).
"""

from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.modes import Mode
from sim.tuning import Action

if TYPE_CHECKING:
    from sim.autopilot import Autopilot

POSITION_LOSS_S = 1.0
"""A position that is gone this long is a failure (COM_POS_FS_DELAY)."""
_SEVERITY = [Action.NONE, Action.WARN, Action.HOLD, Action.RETURN, Action.LAND, Action.DISARM]
_DOING = {Mode.RTL: Action.RETURN, Mode.LAND: Action.LAND}


class Failsafes:
    """Watches one vehicle. `heard` is told of messages, `check` is called each step; times of HEARTBEATs of ground
    stations run on the protocol clock, because they come from outside."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._heard_s: float | None = None
        self._link_lost_s: float | None = None
        self._link_acted = False
        self._interrupted: Mode | None = None
        self._levels_passed = 0
        self._no_position_s: float | None = None
        self._outside = False
        self._without_setpoints: Mode | None = None
        self.active = False

    @property
    def link_lost(self) -> bool:
        """Whether a ground station was heard once and is silent now."""
        return self._link_lost_s is not None

    def reset(self) -> None:
        """Start over, as after a reboot."""
        self.__init__(self._autopilot)  # type: ignore[misc]

    def heard(self, message: Any, wall_s: float) -> None:
        """Take a HEARTBEAT; it counts if it is the ground station's."""
        gcs = self._autopilot.parameters.tuning.link_loss.gcs_system_id
        if message.type == dialect.MAV_TYPE_GCS and gcs in (None, message.get_srcSystem()):
            self._heard_s = wall_s

    def check(self, now_s: float, wall_s: float) -> None:
        """Let the failsafes act that are due."""
        self._check_link(wall_s)
        self._check_battery()
        self._check_position(now_s)
        self._check_fence()
        self._check_setpoints(now_s)
        if not self._autopilot.armed:
            self.active = False

    def _check_link(self, wall_s: float) -> None:
        rule = self._autopilot.parameters.tuning.link_loss
        if self._heard_s is None:
            return
        if wall_s - self._heard_s < rule.timeout_s:
            if self._link_lost_s is not None:
                self._link_lost_s = None
                self._link_is_back()
            return
        if self._link_lost_s is None:
            self._link_lost_s, self._link_acted = wall_s, False
            self._interrupted = self._autopilot.mode
            if self._flying and rule.action not in (Action.NONE, Action.WARN) and rule.delay_s > 0.0:
                self._do(Action.HOLD, "Connection to ground station lost", "gcs_lost")
        if not self._link_acted and wall_s - self._link_lost_s >= rule.delay_s:
            self._link_acted = True
            if not (rule.spare_mission and self._autopilot.mode is Mode.MISSION):
                self._do(rule.action, "GCS Failsafe", "gcs_lost")

    def _link_is_back(self) -> None:
        """PX4 goes back to what it did; ArduPilot stays in its failsafe."""
        self._autopilot.say("Connection to ground station regained")
        resume = self._autopilot.flavour.resumes_after_link_loss and self.active
        if resume and self._interrupted is not None and self._flying:
            self._autopilot.set_mode(self._interrupted)
        if resume:
            self.active = False

    def _check_battery(self) -> None:
        levels = self._autopilot.parameters.tuning.batteries
        passed = sum(self._autopilot.battery.share < level.share for level in levels)
        for level in levels[self._levels_passed : passed]:
            self._do(level.action, level.words, "battery")
        self._levels_passed = passed

    def _check_position(self, now_s: float) -> None:
        if self._autopilot.satellites:
            self._no_position_s = None
            return
        if self._no_position_s is None:
            self._no_position_s = now_s + POSITION_LOSS_S
        if now_s >= self._no_position_s:
            self._no_position_s = float("inf")
            self._do(self._autopilot.parameters.tuning.position_loss, "Position estimate lost", "position_lost")

    def _check_fence(self) -> None:
        rule = self._autopilot.parameters.tuning.fence
        if rule.action is Action.NONE:
            return
        outside = self._autopilot.plans.fence.is_broken(self._autopilot.seen, rule, self._autopilot.home_m)
        if outside and not self._outside:
            self._do(rule.action, "Fence breached", "fence")
        self._outside = outside

    def _check_setpoints(self, now_s: float) -> None:
        """PX4 leaves OFFBOARD when nobody streams any more, and is well again once it is told to do something else."""
        if self._without_setpoints not in (None, self._autopilot.mode):
            self.active, self._without_setpoints = False, None
        autopilot, tuning = self._autopilot, self._autopilot.parameters.tuning
        setpoint = autopilot.navigator.setpoint
        if autopilot.mode is not Mode.GUIDED or not autopilot.flavour.guided_needs_stream or setpoint is None:
            return
        if now_s - setpoint.at_s > tuning.setpoint_timeout_s:
            self._do(tuning.setpoint_loss, "Offboard control lost", "setpoints_lost")
            self._without_setpoints = autopilot.mode if self.active else None

    @property
    def _flying(self) -> bool:
        return self._autopilot.armed and not self._autopilot.body.on_ground

    def _do(self, action: Action, words: str, cause: str) -> None:
        autopilot = self._autopilot
        if action is Action.NONE:
            return
        autopilot.say(words, dialect.MAV_SEVERITY_CRITICAL)
        if action is Action.WARN or not self._flying:
            return
        if _SEVERITY.index(action) <= _SEVERITY.index(_DOING.get(autopilot.mode, Action.NONE)):
            return
        self.active = True
        autopilot.emit("failsafe", {"cause": cause, "action": action.name})
        if action is Action.DISARM:
            autopilot.disarm(force=True)
            return
        modes = {Action.HOLD: autopilot.flavour.failsafe_hold, Action.RETURN: Mode.RTL, Action.LAND: Mode.LAND}
        if action is Action.RETURN and not autopilot.satellites:
            autopilot.set_mode(Mode.LAND)
        else:
            autopilot.set_mode(modes[action])
