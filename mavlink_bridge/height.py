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

_BRAKES_MPS2 = 15.0
"""No multirotor slows its descent by more than this: one that would have to cannot help hitting the ground."""
_LEAST_HIT_MPS = 6.0
"""Slower than this it may still land, however low it is."""
_LEAST_BRAKING_M = 0.1
_ROSE_M = 2.0
"""One that is so much higher again did not hit the ground."""


class Height:
    """Metres above home and metres per second down, as reported and as measured; times are fleet seconds."""

    def __init__(self) -> None:
        self.up_m = 0.0
        self.sinking_mps = 0.0
        self.boot_ms: int | None = None
        self.heard_s = float("-inf")
        self.is_known = False
        """Whether it was ever heard, by this process or, with this height, by an earlier one."""
        self.hit_mps: float | None = None
        """How fast it came down when it was so low that it could no longer brake; None if it never was."""
        self.hit_m = 0.0
        """How high it was then."""
        self.falling_mps = 0.0
        """How fast it descends, m/s: the lesser of its reported speed and the change of its reported height."""
        self._heights: deque[tuple[float, float]] = deque(maxlen=64)

    def hear(self, fields: Mapping[str, Any], now_s: float) -> None:
        """Take in a GLOBAL_POSITION_INT: millimetres, centimetres a second, milliseconds since boot."""
        self.up_m = int(fields["relative_alt"]) / 1000
        self.sinking_mps = int(fields.get("vz", 0)) / 100
        self.boot_ms = int(fields["time_boot_ms"])
        self.heard_s, self.is_known = now_s, True
        self._judge_hit(now_s)
        self._heights.append((now_s, self.up_m))
        while now_s - self._heights[0][0] > 2 * _RATE_OVER_S:
            self._heights.popleft()
        self.falling_mps = self._falls_at_mps()

    def _judge_hit(self, now_s: float) -> None:
        """Judge by the speed it reports, and by its height now and just before, whether it is about to hit the ground.

        A fall from 10 m takes 1.4 s: it is over before a descent could be seen to last.
        """
        if self.hit_mps is not None and self.up_m > self.hit_m + _ROSE_M:
            self.hit_mps = None
        then_s, then_m = self._heights[-1] if self._heights else (now_s, self.up_m)
        if not 0 < now_s - then_s <= _RATE_OVER_S:
            return
        speed_mps = min(self.sinking_mps, (then_m - self.up_m) / (now_s - then_s))
        braking_m = speed_mps**2 / (2 * _BRAKES_MPS2)
        if speed_mps > _LEAST_HIT_MPS and max(self.up_m, _LEAST_BRAKING_M) < braking_m:
            self.hit_mps, self.hit_m = speed_mps, self.up_m

    def assume(self, up_m: float, heard_s: float) -> None:
        """Take over what was known of it before this process was started, unless more is known."""
        if self.boot_ms is None:
            self.up_m, self.heard_s, self.is_known = up_m, heard_s, True

    def forget_hit(self) -> None:
        """Begin a new flight: how it came down before does not count."""
        self.hit_mps = None

    def is_fresh(self, now_s: float) -> bool:
        """Return whether it was reported lately."""
        return now_s - self.heard_s <= FRESH_S

    def _falls_at_mps(self) -> float:
        at_s, up_m = self._heights[-1]
        for then_s, then_m in self._heights:
            if 0 < at_s - then_s <= _RATE_OVER_S:
                return min(self.sinking_mps, (then_m - up_m) / (at_s - then_s))
        return 0.0

    def is_steady(self, now_s: float) -> bool:
        """Return whether it keeps its height, by positions that span long enough."""
        recent = [(at_s, up_m) for at_s, up_m in self._heights if self.heard_s - at_s <= 2 * _STEADY_FOR_S]
        if not self.is_fresh(now_s) or self.heard_s - recent[0][0] < _STEADY_FOR_S:
            return False
        heights = [up_m for _, up_m in recent]
        return max(heights) - min(heights) <= _STEADY_M and abs(self.sinking_mps) <= _STEADY_MPS
