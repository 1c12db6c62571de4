"""The clock inside one autopilot: when it was switched on, and what time it believes that it is."""

from skyfolio.sim.clock import EPOCH_S, NOON_S

DAY_S = 86_400.0


class OnboardClock:
    """Fleet time as one autopilot reads it.

    `now_s` is the fleet time of its last step, `boot_s` the fleet time at which it was switched on, and `offset_s` how
    far its clock has jumped since, all in seconds.
    """

    def __init__(self, now_s: float, booted_s_ago: float) -> None:
        self.now_s = now_s
        self.boot_s = now_s - booted_s_ago
        self.offset_s = 0.0

    @property
    def age_s(self) -> float:
        """Seconds since power on, as they really passed."""
        return self.now_s - self.boot_s

    @property
    def boot_ms(self) -> int:
        """Milliseconds since boot (`time_boot_ms`); a clock jump can take them below zero, where they wrap."""
        return int((self.now_s - self.boot_s + self.offset_s) * 1000.0) & 0xFFFFFFFF

    @property
    def unix_s(self) -> float:
        """Unix time in seconds (SYSTEM_TIME)."""
        return EPOCH_S + self.now_s + self.offset_s

    def utc_s(self, now_s: float) -> float:
        """Return seconds since midnight UTC at a moment of fleet time."""
        return (now_s + NOON_S + self.offset_s) % DAY_S

    def restart(self, now_s: float) -> None:
        """Start again from zero at a moment of fleet time, as a reboot does."""
        self.now_s = self.boot_s = now_s
        self.offset_s = 0.0

    def thaw(self, frozen_s: float) -> None:
        """Leave out `frozen_s` seconds in which the autopilot hung and its clock stood still."""
        self.boot_s += frozen_s
