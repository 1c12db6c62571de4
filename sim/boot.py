"""From power on to ready: what an autopilot sends while it starts, and when it knows where it is.

Measured on ArduCopter 4.6.2 and PX4 1.18 in software (recordings): an ArduCopter sends STATUSTEXTs at once, sets its
origin and home after 17 s and arms in a mode that needs a position only after about 40 s; a PX4 is ready in seconds.
"""

from dataclasses import dataclass
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.hosts import Refusal
from skyfolio.sim.knobs import LONGEST_S
from skyfolio.sim.onboard_clock import OnboardClock

_INFO, _CRITICAL = dialect.MAV_SEVERITY_INFO, dialect.MAV_SEVERITY_CRITICAL


@dataclass(frozen=True, kw_only=True)
class BootPlan:
    """When each stage of a start is over, in seconds after power on.

    fix_s: the receiver has a fix. home_s: origin and home are set, and positions are sent. ready_s: the estimate is
    good enough to arm and fly by. reminder_s: the interval at which the autopilot sends why it cannot be armed yet, or
    None if it never does. words: its STATUSTEXTs as (second, MAV_SEVERITY, text).
    """

    fix_s: float
    home_s: float
    ready_s: float
    reminder_s: float | None
    words: tuple[tuple[float, int, str], ...] = ()


ARDUPILOT_BOOT = BootPlan(
    fix_s=6.9,
    home_s=17.0,
    ready_s=40.0,
    reminder_s=30.0,
    words=(
        (1.5, _INFO, "EKF3 IMU0 initialised"),
        (1.5, _INFO, "EKF3 IMU1 initialised"),
        (1.5, _INFO, "AHRS: EKF3 active"),
        (2.8, _INFO, "EKF3 IMU0 tilt alignment complete"),
        (2.8, _INFO, "EKF3 IMU1 tilt alignment complete"),
        (2.9, _INFO, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
        (2.9, _INFO, "EKF3 IMU1 MAG0 initial yaw alignment complete"),
        (6.8, _INFO, "GPS 1: probing for u-blox at 230400 baud"),
        (6.8, _INFO, "GPS 1: detected u-blox"),
        (17.0, _INFO, "EKF3 IMU0 origin set"),
        (17.2, _INFO, "EKF3 IMU1 origin set"),
        (40.0, _INFO, "EKF3 IMU0 is using GPS"),
        (40.0, _INFO, "EKF3 IMU1 is using GPS"),
    ),
)
PX4_BOOT = BootPlan(fix_s=1.0, home_s=3.0, ready_s=6.0, reminder_s=None)


class BootHost(Protocol):
    """The vehicle that starts."""

    clock: OnboardClock

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""

    def send_text(self, words: str, severity: int) -> None:
        """Send a STATUSTEXT of a MAV_SEVERITY."""

    def set_home_here(self) -> None:
        """Make the present place home, and send it."""

    def arming_refusal(self, *, tag: str) -> Refusal:
        """Return why the vehicle cannot be armed, in texts that begin with `tag`."""


class Boot:
    """One start of one autopilot; one that was started long ago has sent everything already."""

    def __init__(self, host: BootHost, plan: BootPlan) -> None:
        self._host = host
        self._plan = plan
        age_s = self.age_s
        self._words = [entry for entry in plan.words if entry[0] > age_s]
        self._home_is_set = age_s >= plan.home_s
        self._reminder_s = plan.reminder_s
        self._is_ready = self._is_over = False

    @property
    def age_s(self) -> float:
        """Seconds since power on."""
        return self._host.clock.age_s

    @property
    def has_fix(self) -> bool:
        """Whether the receiver has found its satellites."""
        return self.age_s >= self._plan.fix_s

    @property
    def has_home(self) -> bool:
        """Whether origin and home are set; before that there is no position to send."""
        return self.age_s >= self._plan.home_s or self._host.armed

    @property
    def ready(self) -> bool:
        """Whether the estimate is good enough to fly by."""
        if not self._is_ready:
            self._is_ready = self.age_s >= self._plan.ready_s
        return self._is_ready

    @property
    def is_over(self) -> bool:
        """Whether the start is over, and nothing of it is still to be sent."""
        return self._is_over

    def step(self) -> None:
        """Send what is due by now."""
        if self._is_over:
            return
        host = self._host
        while self._words and self._words[0][0] <= self.age_s:
            _, severity, words = self._words.pop(0)
            host.send_text(words, severity)
        if not self._home_is_set and self.has_home:
            self._home_is_set = True
            host.set_home_here()
        self._is_over = self.ready and self._home_is_set and not self._words
        if self._reminder_s is not None and not self.ready and self.age_s >= self._reminder_s:
            self._reminder_s += self._plan.reminder_s or LONGEST_S
            for words, severity in host.arming_refusal(tag="PreArm"):
                host.send_text(words, severity)
