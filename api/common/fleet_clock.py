"""The fleet's clock: monotonic, and accelerated as a simulated fleet is."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from skyfolio.api.common.surroundings import monotonic_s, utc_s


class FleetClock:
    """Fleet seconds since the clock was made: `seconds()` multiplied by `scale`.

    seconds, utc: monotonic and UTC seconds, by default those of the wall. A simulated fleet that waits for late
    participants gives its own, which both advance together.
    """

    def __init__(
        self,
        scale: float = 1.0,
        *,
        seconds: Callable[[], float] = monotonic_s,
        utc: Callable[[], float] = utc_s,
    ) -> None:
        self.scale = scale
        self._seconds, self._utc = seconds, utc
        self._origin = seconds()

    def now(self) -> float:
        """Return the fleet seconds, which never run backwards."""
        return (self._seconds() - self._origin) * self.scale

    def utc_of(self, ago_s: float) -> float:
        """Return the UTC second of what was so many fleet seconds ago; it outlives this process."""
        return self._utc() - ago_s / self.scale

    def since_utc(self, at: float) -> float:
        """Return the fleet seconds since a UTC second."""
        return (self._utc() - at) * self.scale

    async def sleep(self, seconds: float) -> None:
        """Sleep that many fleet seconds."""
        until_s = self.now() + seconds
        while (left_s := until_s - self.now()) > 0:  # noqa: ASYNC110 - it may pass more slowly than the loop's time
            await asyncio.sleep(left_s / self.scale)
