"""How late a loaded machine lets this process be: what a test has to allow for that measures time on the wall."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

NAP_S = 0.02


class Lateness:
    """Wall seconds in all that the event loop of this process has waited for the machine, so far."""

    late_s = 0.0

    async def measure(self) -> None:
        """Nap, and note by how much too long each nap was."""
        while True:
            began_s = time.monotonic()
            await asyncio.sleep(NAP_S)
            self.late_s += max(0.0, time.monotonic() - began_s - 1.5 * NAP_S)


@asynccontextmanager
async def lateness() -> AsyncIterator[Lateness]:
    """Measure it meanwhile."""
    made = Lateness()
    measuring = asyncio.create_task(made.measure())
    try:
        yield made
    finally:
        measuring.cancel()
        with suppress(asyncio.CancelledError):
            await measuring
