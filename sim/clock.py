"""Fleet time: everything that flies reads one injected clock, so that a test can move it and a demo can speed it up."""

import time
from collections.abc import Callable
from typing import Protocol

NOON_S = 12 * 3600
"""UTC time of day at fleet time 0, in seconds since midnight."""
EPOCH_S = 1_767_225_600 + NOON_S
"""Unix time at fleet time 0: 2026-01-01, noon UTC."""


class Clock(Protocol):
    """Anything that has fleet time."""

    def now(self) -> float:
        """Return fleet seconds; never runs backwards."""
        ...


class ScaledClock:
    """Fleet time that runs `speedup` times as fast as `source` (wall seconds), from 0 at construction."""

    def __init__(self, speedup: float = 1.0, *, source: Callable[[], float] = time.monotonic) -> None:
        if not 0.0 < speedup < float("inf"):
            raise ValueError(f"speedup must be a positive number, got {speedup}")
        self.speedup = speedup
        self._source = source
        self._origin = source()

    def now(self) -> float:
        """Return fleet seconds since construction."""
        return (self._source() - self._origin) * self.speedup


class VirtualClock:
    """Fleet time that stands still until `advance` moves it."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s

    def now(self) -> float:
        """Return fleet seconds."""
        return self._now

    def advance(self, seconds: float) -> float:
        """Move time forward by `seconds` >= 0 and return the new time; ValueError for a step backwards."""
        if not 0.0 <= seconds < float("inf"):
            raise ValueError(f"time moves forward only, got a step of {seconds} s")
        self._now += seconds
        return self._now
