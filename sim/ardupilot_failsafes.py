"""ArduCopter's failsafes (events.cpp, ekf_check.cpp and fence.cpp of 4.6): each acts at once and announces it.

HEARTBEAT.system_status is critical as long as one is on, whatever the mode: on the ground, in AUTO that goes on, and
for the rest of the flight after a battery failsafe. When the ground station is back only the status clears; the mode
stays.
"""

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.failsafes import FailsafeHost, Failsafes
from skyfolio.sim.geofence import Fence
from skyfolio.sim.modes import Mode
from skyfolio.sim.tuning import Action, Breach, LowBattery

_WARNING, _CRITICAL, _NOTICE = dialect.MAV_SEVERITY_WARNING, dialect.MAV_SEVERITY_CRITICAL, dialect.MAV_SEVERITY_NOTICE
_FENCES = {Breach.CEILING: "Max Alt", Breach.RADIUS: "Circle", Breach.SHAPES: "Polygon"}


class ArdupilotFailsafes(Failsafes):
    """The failsafes of an ArduCopter."""

    position_loss_s = 8.0  # measured: GPS off to LAND

    def __init__(self, host: FailsafeHost, fence: Fence) -> None:
        super().__init__(host, fence)
        self._on: set[str] = set()

    @property
    def active(self) -> bool:
        """Whether any failsafe is on (any_failsafe_triggered)."""
        return bool(self._on)

    def taken_over(self) -> None:
        """Keep what is on: the status shows the cause, not the mode."""

    def disarmed(self) -> None:
        """Keep what is on."""

    def _link_is_lost(self) -> None:
        rule = self._host.parameters.tuning.link_loss
        if rule.action is Action.NONE:
            return
        self._on.add("gcs")
        if not self._host.armed:
            self._announce("GCS")
        elif self._host.landed:
            self._announce("GCS", "Disarming")
            self._host.disarm()
        elif self._host.dynamics.landing and rule.spare_landing:
            self._announce("GCS", "Continuing Landing")
            self._do(Action.LAND, "gcs_lost")
        elif self._host.mode is Mode.MISSION and rule.spare_mission:
            self._announce("GCS", "Continuing Auto Mode")
        elif self._host.mode.is_flown_by_a_pilot and rule.spare_pilot:
            self._announce("GCS", "Continuing Pilot Control")
        else:
            self._announce("GCS")
            self._do(rule.action, "gcs_lost")

    def _link_is_back(self) -> None:
        if "gcs" in self._on:
            self._on.discard("gcs")
            self._host.send_text("GCS Failsafe Cleared", _WARNING)

    def _battery_fell(self, levels: tuple[LowBattery, ...]) -> None:
        host = self._host
        used_mah = host.gauge.used * host.parameters.tuning.battery_capacity_mah
        for level in levels:
            host.send_text(f"{level.words} {host.battery.voltage_v:.2f}V used {used_mah:.0f} mAh", _WARNING)
        self._on.add("battery")
        if host.armed and host.landed:
            self._announce("Battery", "Disarming")
            host.disarm()
            return
        self._announce("Battery")
        self._do(levels[-1].action, "battery")

    def _position_is_lost(self) -> None:
        host = self._host
        action = host.parameters.tuning.position_loss
        self._on.add("ekf")
        host.send_text("EKF variance", _CRITICAL)
        if not host.armed or not host.mode.needs_position or action is Action.NONE:
            return
        self._do(action, "position_lost")
        name = host.traits.mode_names[host.mode]
        host.send_text(f"EKF Failsafe: changed to {name} Mode", _CRITICAL)

    def _position_is_back(self) -> None:
        self._on.discard("ekf")
        self._host.send_text("EKF Failsafe Cleared", _CRITICAL)

    def _fence_is_broken(self, breach: Breach) -> None:
        if not self._host.armed:
            return
        if not self._host.landed:
            self._host.send_text(f"{_FENCES[breach]} fence breached", _NOTICE)
        self._do(self._host.parameters.tuning.fence.action, "fence", hold=Mode.BRAKE)

    def _fence_is_whole(self) -> None:
        if self._host.armed and not self._host.landed:
            self._host.send_text("Fence breach cleared", _NOTICE)

    def _announce(self, kind: str, doing: str | None = None) -> None:
        self._host.send_text(f"{kind} Failsafe - {doing}" if doing else f"{kind} Failsafe", _WARNING)

    def _do(self, action: Action, cause: str, hold: Mode = Mode.HOLD) -> None:
        if action in (Action.NONE, Action.WARN) or not self._flying or self._milder_than_now(action):
            return
        self._act(action, cause, hold)
