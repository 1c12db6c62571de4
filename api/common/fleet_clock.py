"""The fleet's clock: monotonic, and accelerated as a simulated fleet is."""

from __future__ import annotations

import asyncio
import time


class FleetClock:
    """Fleet seconds since the clock was made: wall time multiplied by `scale`."""

    def __init__(self, scale: float = 1.0) -> None:
        self.scale = scale
        self._origin = time.monotonic()

    def now(self) -> float:
        """Return the fleet seconds, which never run backwards."""
        return (time.monotonic() - self._origin) * self.scale

    async def sleep(self, seconds: float) -> None:
        """Sleep that many fleet seconds."""
        await asyncio.sleep(max(seconds, 0.0) / self.scale)
