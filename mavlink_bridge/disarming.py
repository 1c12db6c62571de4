"""Judge a UAV that flew and reports to be disarmed: landed, fallen, or contradictory. Pure, used by `evidence`.

Without thrust a multirotor falls. So a disarmed one that was high is down or comes down fast; if its positions say that
it stays up there, one of the two is wrong, and its air must not be given to others. ArduCopter reports "on the ground"
whenever it is disarmed, also while it falls after a restart: its landed state only counts as long as it is armed. One
that has restarted since may be heard again long after its fall: then its clock tells when its motors stopped.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from skyfolio.mavlink_bridge.conditions import Timing
from skyfolio.mavlink_bridge.height import Height

_BEATS = 2
"""The number of HEARTBEATs in a row that must report it before it is believed of a UAV in the air."""
_ON_GROUND, _LANDING = 1, 4
"""MAV_LANDED_STATE."""
_LANDING_MPS = 3.0
"""No autopilot descends faster than this all the way to the ground; a free fall of 2 m is faster on average."""
_ON_GROUND_S = 2.0
"""A UAV that has landed stands so long at least until it is disarmed, by its autopilot, or restarted, by people."""


class Fate(Enum):
    """What became of a UAV that is disarmed."""

    UNKNOWN = "not reported often enough"
    LANDED = "landed"
    ALOFT = "reported to be disarmed in the air, and not seen to come down"
    FALLEN = "fallen"


@dataclass(kw_only=True, slots=True)
class Disarmed:
    """A UAV that reports to be disarmed: since when, and what was last known before.

    `up_m`, `told_s`: its last height while it was armed, and when that was received, minus infinity if that is not
    known. `landing`: whether it was landing.
    """

    since_s: float
    up_m: float
    told_s: float
    landing: bool
    beats: int = 1
    low_s: float | None = None
    """When it was first seen low."""
    booted_s: float | None = None
    """When its autopilot started, if that was after it was last known to be armed."""

    @classmethod
    def now(cls, height: Height, landed_state: int, now_s: float) -> Disarmed:
        """Return the record of a UAV that has just reported it."""
        told_s = height.heard_s if height.is_known else now_s
        landing = landed_state in (_ON_GROUND, _LANDING)
        return cls(since_s=now_s, up_m=height.up_m, told_s=told_s, landing=landing)

    def see(self, height: Height, timing: Timing) -> None:
        """Take in where it is seen now, and since when its clock runs."""
        booted_s = None if height.boot_ms is None else height.heard_s - height.boot_ms / 1000
        if booted_s is not None and booted_s > self.told_s > float("-inf"):
            self.booted_s = booted_s
        if self.low_s is None and height.heard_s >= self.since_s and height.up_m <= timing.crash_height_m:
            self.low_s = height.heard_s

    def fate(self, height: Height, timing: Timing, now_s: float) -> Fate:
        """Return what became of it."""
        if self.up_m <= timing.crash_height_m:
            return Fate.LANDED
        if self.beats < _BEATS:
            return Fate.UNKNOWN
        if height.heard_s < self.since_s:
            down_s = self.since_s + self.up_m / timing.crash_descent_mps
            return Fate.FALLEN if now_s >= down_s else Fate.ALOFT
        if self.low_s is not None:
            fell = self.up_m - height.up_m > _LANDING_MPS * self._landing_s(self.low_s)
            return Fate.FALLEN if fell and not self._was_landing else Fate.LANDED
        if height.falling_mps > timing.crash_descent_mps:
            return Fate.FALLEN
        return Fate.LANDED if self._was_landing and height.is_steady(now_s) else Fate.ALOFT

    @property
    def _was_landing(self) -> bool:
        """Return whether it was; one that has restarted reports what it reports of any start."""
        return self.landing and self.booted_s is None

    def _landing_s(self, low_s: float) -> float:
        """Return the time in which it can have landed, from where it was last known to be armed, until it was low."""
        if self.booted_s is None:
            return low_s - self.told_s
        return max(0.0, min(low_s, self.booted_s - _ON_GROUND_S) - self.told_s)

    def seen(self, height: Height) -> str:
        """Return what was seen, in words with numbers."""
        if height.heard_s < self.since_s:
            return f"disarmed at {self.up_m:.1f} m above home, where it was last heard"
        if self.low_s is not None and self.told_s > float("-inf"):
            took = f"in {self.low_s - self.told_s:.1f} s"
            if self.booted_s is not None:
                took += f", restarted {self.booted_s - self.told_s:.1f} s after it was last seen up there"
            return f"disarmed, and down from {self.up_m:.1f} to {height.up_m:.1f} m above home {took}"
        return f"disarmed at {height.up_m:.1f} m above home, sinking at {height.falling_mps:.1f} m/s"
