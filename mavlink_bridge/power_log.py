"""What a vehicle draws from its battery in flight: Wh since it was armed, and samples of power against motion. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

MOST_SAMPLES = 1800
"""Half an hour at the 1 Hz of SYS_STATUS; the oldest are dropped."""
FRESH_S = 1.5
"""A velocity that is older than this is not that of the power."""
LONGEST_GAP_S = 10.0
"""Between two reports: after more than this the power in between is not guessed, but counted as for so long."""
_UNKNOWN_MV, _UNKNOWN_CA = 65535, -1


class PowerSample(NamedTuple):
    """Electrical power, W, and velocity over ground, m/s, of one moment in the air."""

    power_w: float
    east_mps: float
    north_mps: float
    up_mps: float


def power_w_of(fields: Mapping[str, Any]) -> float | None:
    """Return voltage times current of SYS_STATUS (1), W: the sums of BATTERY_STATUS; None if one is not measured."""
    millivolts, centiamperes = int(fields.get("voltage_battery", _UNKNOWN_MV)), int(fields.get("current_battery", -1))
    if millivolts == _UNKNOWN_MV or centiamperes <= _UNKNOWN_CA:
        return None
    return millivolts / 1000 * centiamperes / 100


class PowerLog:
    """The power of one vehicle."""

    def __init__(self) -> None:
        self.power_w: float | None = None
        """As last reported; None if it is not measured."""
        self.used_wh: float | None = None
        """Since it was armed last; None if that was never measured."""
        self.samples: deque[PowerSample] = deque(maxlen=MOST_SAMPLES)
        self._at_s: float | None = None

    def arm(self) -> None:
        """Begin to count anew."""
        self.used_wh, self._at_s = None, None

    def add(self, power_w: float | None, now_s: float, *, armed: bool) -> None:
        """Take in a report; power is taken to change in a straight line since the one before."""
        before_w, before_s = self.power_w, self._at_s
        self.power_w = power_w
        if power_w is None or not armed:
            self._at_s = None
            return
        self._at_s = now_s
        if before_w is not None and before_s is not None:
            passed_s = min(max(now_s - before_s, 0.0), LONGEST_GAP_S)
            self.used_wh = (self.used_wh or 0.0) + (before_w + power_w) / 2.0 * passed_s / 3600.0

    def sample(self, position: Mapping[str, Any], position_at_s: float, now_s: float) -> None:
        """Keep a sample of the latest power with the velocity of a GLOBAL_POSITION_INT (33), if that is fresh."""
        if self.power_w is not None and now_s - position_at_s <= FRESH_S:
            east, north, up = position["vy"] / 100, position["vx"] / 100, -position["vz"] / 100
            self.samples.append(PowerSample(self.power_w, east, north, up))
