"""From power to ready: what an autopilot says while it starts, and when it knows where it is.

Measured on ArduCopter 4.6.2 and PX4 1.18 in software (recordings): an ArduCopter speaks at once, sets its origin and
home after 17 s and arms in a mode that needs a position only after about 40 s; a PX4 is ready within seconds.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.knobs import LONGEST_S, check_number

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

BOOTED_S_AGO = 60.0
"""How long a vehicle has been on when nobody says otherwise: long enough to be ready."""
_INFO, _CRITICAL = dialect.MAV_SEVERITY_INFO, dialect.MAV_SEVERITY_CRITICAL


@dataclass(frozen=True, kw_only=True)
class BootPlan:
    """Seconds after power on, and the words (second, severity, text) that go with it.

    fix_s: the receiver has a fix. home_s: origin and home are set, positions are sent. ready_s: the estimate is good
    enough to arm and fly by. reminder_s: how often it says why it cannot be armed yet, None: never.
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


class Boot:
    """One start of one autopilot; one that was started long ago has said everything already."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._plan: BootPlan = autopilot.flavour.boot
        age_s = self.age_s
        self._words = [entry for entry in self._plan.words if entry[0] > age_s]
        self._home_told = age_s >= self._plan.home_s
        self._reminder_s = self._plan.reminder_s

    @property
    def age_s(self) -> float:
        """Seconds since power on."""
        return self._autopilot.now_s - self._autopilot.boot_s

    @property
    def has_fix(self) -> bool:
        """Whether the receiver has found its satellites."""
        return self.age_s >= self._plan.fix_s

    @property
    def has_home(self) -> bool:
        """Whether origin and home are set: before that a position is none."""
        return self.age_s >= self._plan.home_s or self._autopilot.armed

    @property
    def ready(self) -> bool:
        """Whether the estimate is good enough to fly by."""
        return self.age_s >= self._plan.ready_s

    def step(self) -> None:
        """Say what is due."""
        autopilot = self._autopilot
        while self._words and self._words[0][0] <= self.age_s:
            _, severity, words = self._words.pop(0)
            autopilot.say(words, severity)
        if not self._home_told and self.has_home:
            self._home_told = True
            autopilot.set_home_here()
        if self._reminder_s is not None and not self.ready and self.age_s >= self._reminder_s:
            self._reminder_s += self._plan.reminder_s or LONGEST_S
            for words, severity in autopilot.flavour.arming_refusal(autopilot, tag="PreArm"):
                autopilot.say(words, severity)


def check_booted(booted_s_ago: float) -> None:
    """Raise ValueError unless a vehicle can have been on for so long."""
    check_number("booted_s_ago", booted_s_ago, 0.0, LONGEST_S)
