"""ArduCopter's failsafes (events.cpp, ekf_check.cpp and fence.cpp of 4.6): each acts at once and says so.

HEARTBEAT.system_status is critical as long as one is on, whatever the mode: on the ground, in AUTO that goes on, and
for the rest of the flight after a battery's. The mode stays when the ground station is back, only the status clears.
"""

from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.failsafes import Failsafes
from skyfolio.sim.modes import Mode
from skyfolio.sim.tuning import Action, Breach, LowBattery

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

_WARNING, _CRITICAL, _NOTICE = dialect.MAV_SEVERITY_WARNING, dialect.MAV_SEVERITY_CRITICAL, dialect.MAV_SEVERITY_NOTICE
_FENCES = {Breach.CEILING: "Max Alt", Breach.RADIUS: "Circle", Breach.SHAPES: "Polygon"}


class ArdupilotFailsafes(Failsafes):
    """One ArduCopter's."""

    position_loss_s = 8.0  # measured: GPS off to LAND

    def __init__(self, autopilot: "Autopilot") -> None:
        super().__init__(autopilot)
        self._on: set[str] = set()

    @property
    def active(self) -> bool:
        """Whether any failsafe is on (any_failsafe_triggered)."""
        return bool(self._on)

    def taken_over(self) -> None:
        """Keep what is on: the status tells of the cause, not of the mode."""

    def disarmed(self) -> None:
        """Keep what is on."""

    def _link_is_lost(self) -> None:
        rule = self._autopilot.parameters.tuning.link_loss
        if rule.action is Action.NONE:
            return
        self._on.add("gcs")
        if not self._autopilot.armed:
            self._announce("GCS")
        elif self._autopilot.landed:
            self._announce("GCS", "Disarming")
            self._autopilot.disarm()
        elif self._autopilot.dynamics.landing and rule.spare_landing:
            self._announce("GCS", "Continuing Landing")
            self._do(Action.LAND, "gcs_lost")
        elif self._autopilot.mode is Mode.MISSION and rule.spare_mission:
            self._announce("GCS", "Continuing Auto Mode")
        elif self._autopilot.mode.is_flown_by_a_pilot and rule.spare_pilot:
            self._announce("GCS", "Continuing Pilot Control")
        else:
            self._announce("GCS")
            self._do(rule.action, "gcs_lost")

    def _link_is_back(self) -> None:
        if "gcs" in self._on:
            self._on.discard("gcs")
            self._autopilot.say("GCS Failsafe Cleared", _WARNING)

    def _battery_fell(self, levels: tuple[LowBattery, ...]) -> None:
        autopilot = self._autopilot
        used_mah = (1.0 - autopilot.battery.share) * autopilot.parameters.tuning.battery_capacity_mah
        for level in levels:
            autopilot.say(f"{level.words} {autopilot.battery.voltage_v:.2f}V used {used_mah:.0f} mAh", _WARNING)
        self._on.add("battery")
        if autopilot.armed and autopilot.landed:
            self._announce("Battery", "Disarming")
            autopilot.disarm()
            return
        self._announce("Battery")
        self._do(levels[-1].action, "battery")

    def _position_is_lost(self) -> None:
        autopilot = self._autopilot
        action = autopilot.parameters.tuning.position_loss
        self._on.add("ekf")
        autopilot.say("EKF variance", _CRITICAL)
        if not autopilot.armed or not autopilot.mode.needs_position or action is Action.NONE:
            return
        self._do(action, "position_lost")
        name = autopilot.flavour.mode_names[autopilot.mode]
        autopilot.say(f"EKF Failsafe: changed to {name} Mode", _CRITICAL)

    def _position_is_back(self) -> None:
        self._on.discard("ekf")
        self._autopilot.say("EKF Failsafe Cleared", _CRITICAL)

    def _fence_is_broken(self, breach: Breach) -> None:
        if not self._autopilot.armed:
            return
        if not self._autopilot.landed:
            self._autopilot.say(f"{_FENCES[breach]} fence breached", _NOTICE)
        self._do(self._autopilot.parameters.tuning.fence.action, "fence", hold=Mode.BRAKE)

    def _fence_is_whole(self) -> None:
        if self._autopilot.armed and not self._autopilot.landed:
            self._autopilot.say("Fence breach cleared", _NOTICE)

    def _announce(self, kind: str, doing: str | None = None) -> None:
        self._autopilot.say(f"{kind} Failsafe - {doing}" if doing else f"{kind} Failsafe", _WARNING)

    def _do(self, action: Action, cause: str, hold: Mode = Mode.HOLD) -> None:
        if action in (Action.NONE, Action.WARN) or not self._flying or self._milder_than_now(action):
            return
        self._act(action, cause, hold)
