"""What can go wrong inside one vehicle: parts that fail, and a clock that jumps."""

from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.hosts import Announcer, Equipment


class FailureHost(Announcer, Equipment, Protocol):
    """The vehicle whose parts fail."""

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""


class ComponentFailures:
    """Lets the parts of one autopilot fail, each with an event for the truth log.

    `silenced`: the radio is broken; the station that carries the vehicle's messages has to obey it.
    """

    def __init__(self, host: FailureHost) -> None:
        self._host = host
        self.silenced = False
        self._reboot_requested = False

    def cut_power(self) -> None:
        """Stop the motors for good."""
        self._host.dynamics.cut_power()

    def fail_motor(self) -> None:
        """Stop one motor: a quadrotor falls, armed until it lies on the ground, and cannot be armed again."""
        host = self._host
        if host.dynamics.powered:
            host.emit("motor_failed", {})
            if host.armed and host.traits.words.motor_failed:
                host.send_text(host.traits.words.motor_failed, dialect.MAV_SEVERITY_EMERGENCY)
            host.dynamics.powered = False

    def lose_satellites(self) -> None:
        """Lose the position: the estimate drifts away until the satellites are back."""
        self._host.dynamics.satellites = False
        self._host.emit("gps_lost", {})

    def regain_satellites(self) -> None:
        """Find the position again."""
        self._host.dynamics.satellites = True
        self._host.emit("gps_back", {})

    def set_battery(self, share: float) -> None:
        """Set the charge that is left, from 0 (empty) to 1 (full), as if the rest had been drawn in this flight."""
        self._host.battery.share = share
        self._host.gauge.take_for_drawn()
        self._host.emit("battery_set", {"share": share})

    def jump_clock(self, seconds: float) -> None:
        """Move the autopilot's clock by `seconds`: time_boot_ms, SYSTEM_TIME and TIMESYNC with it."""
        self._host.clock.offset_s += seconds
        self._host.emit("clock_jumped", {"seconds": seconds})

    def silence(self) -> None:
        """Break the radio."""
        self.silenced = True

    def request_reboot(self) -> None:
        """Ask for a reboot at the next step."""
        self._reboot_requested = True

    def take_reboot_request(self) -> bool:
        """Return whether a reboot was requested since the last call."""
        requested, self._reboot_requested = self._reboot_requested, False
        return requested
