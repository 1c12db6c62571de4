"""What can go wrong inside one vehicle: parts that fail, and a clock that jumps."""

from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot


class Mishaps:
    """Lets the parts of one autopilot fail, each with an event for the truth log."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self.silenced = False
        self._reboot_asked = False

    def cut_power(self) -> None:
        """Stop the motors for good."""
        self._autopilot.dynamics.powered = self._autopilot.armed = False

    def fail_motor(self) -> None:
        """Lose a motor: a quadrotor falls, armed until it lies there; on the ground it will not arm again."""
        autopilot = self._autopilot
        if autopilot.dynamics.powered:
            autopilot.emit("motor_failed", {})
            if autopilot.armed and autopilot.flavour.words.motor_failed:
                autopilot.say(autopilot.flavour.words.motor_failed, dialect.MAV_SEVERITY_EMERGENCY)
            autopilot.dynamics.powered = False

    def lose_satellites(self) -> None:
        """Lose the position: the estimate drifts away until it is back."""
        self._autopilot.dynamics.satellites = False
        self._autopilot.emit("gps_lost", {})

    def regain_satellites(self) -> None:
        """Find the position again."""
        self._autopilot.dynamics.satellites = True
        self._autopilot.emit("gps_back", {})

    def set_battery(self, share: float) -> None:
        """Set the charge that is left, 0 to 1."""
        self._autopilot.battery.share = share
        self._autopilot.emit("battery_set", {"share": share})

    def jump_clock(self, seconds: float) -> None:
        """Let the autopilot's clock jump: time_boot_ms, SYSTEM_TIME and TIMESYNC with it."""
        self._autopilot.clock_offset_s += seconds
        self._autopilot.emit("clock_jumped", {"seconds": seconds})

    def silence(self) -> None:
        """Break the radio; whoever carries its messages has to obey (`silenced`)."""
        self.silenced = True

    def ask_reboot(self) -> None:
        """Ask for a reboot at the next step."""
        self._reboot_asked = True

    def take_reboot(self) -> bool:
        """Return whether a reboot was asked for, once."""
        asked, self._reboot_asked = self._reboot_asked, False
        return asked
