"""How high a UAV is and whether it falls, from GLOBAL_POSITION_INT. Pure, used by `evidence`."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

FRESH_S = 2.5
"""Fleet seconds for which a position shows where a UAV is; it is sent at 1 to 5 Hz."""
_RATE_OVER_S = 1.2
"""Fleet seconds over which heights are compared."""
_STEADY_M, _STEADY_MPS, _STEADY_FOR_S = 1.0, 1.0, 1.0
"""It keeps its height if it stays within so many metres for so long and reports to be slower than that."""


class Height:
    """Metres above home and metres per second down, as reported and as measured; times are fleet seconds."""

    def __init__(self) -> None:
        self.up_m = 0.0
        self.sinking_mps = 0.0
        self.boot_ms: int | None = None
        self.heard_s = float("-inf")
        self._heights: deque[tuple[float, float]] = deque(maxlen=64)

    def hear(self, fields: Mapping[str, Any], now_s: float) -> None:
        """Take in a GLOBAL_POSITION_INT: millimetres, centimetres a second, milliseconds since boot."""
        self.up_m = int(fields["relative_alt"]) / 1000
        self.sinking_mps = int(fields.get("vz", 0)) / 100
        self.boot_ms = int(fields["time_boot_ms"])
        self.heard_s = now_s
        self._heights.append((now_s, self.up_m))
        while now_s - self._heights[0][0] > 2 * _RATE_OVER_S:
            self._heights.popleft()

    def is_fresh(self, now_s: float) -> bool:
        """Return whether it was reported lately."""
        return now_s - self.heard_s <= FRESH_S

    @property
    def falling_mps(self) -> float:
        """Return how fast it descends, m/s: the lesser of its reported speed and the change of its reported height."""
        at_s, up_m = self._heights[-1] if self._heights else (0.0, 0.0)
        earlier = [(then_s, then_m) for then_s, then_m in self._heights if 0 < at_s - then_s <= _RATE_OVER_S]
        if not earlier:
            return 0.0
        then_s, then_m = earlier[0]
        return min(self.sinking_mps, (then_m - up_m) / (at_s - then_s))

    def is_steady(self, now_s: float) -> bool:
        """Return whether it keeps its height, by positions that span long enough."""
        recent = [(at_s, up_m) for at_s, up_m in self._heights if self.heard_s - at_s <= 2 * _STEADY_FOR_S]
        if not self.is_fresh(now_s) or self.heard_s - recent[0][0] < _STEADY_FOR_S:
            return False
        heights = [up_m for _, up_m in recent]
        return max(heights) - min(heights) <= _STEADY_M and abs(self.sinking_mps) <= _STEADY_MPS
