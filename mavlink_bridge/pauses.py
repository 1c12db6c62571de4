"""Pauses of our own process: while it is stopped or its event loop is blocked, nothing is received."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

log = logging.getLogger(__name__)

POLL_S = 0.05
"""Wall seconds between two looks: detection is late by at most this, times the speed-up, in fleet time."""
STALL_S = 0.2
"""A look that is later than this was kept by a pause of our own: what was received meanwhile is taken in before anyone
is judged, and silence does not count the pause (`HeartbeatMonitor.missed`)."""


class PauseWatch:
    """Looks every POLL_S wall seconds, and reports how long nothing could be received before.

    missed(now_s, for_s): called with fleet seconds before what was received meanwhile is taken in.
    """

    def __init__(self, now_s: Callable[[], float], missed: Callable[[float, float], None]) -> None:
        self._now_s, self._missed = now_s, missed
        self._awake = (0.0, 0.0)
        """When the event loop was last seen to run: its own seconds, and fleet seconds."""

    def note(self) -> None:
        """Note that the event loop runs, and report a pause that ends with it."""
        woke_s, woke_at_s = self._awake
        self._awake = awake_s, now_s = asyncio.get_running_loop().time(), self._now_s()
        late_s = awake_s - woke_s - POLL_S
        if late_s > STALL_S:
            self._missed(now_s, (now_s - woke_at_s) * late_s / (late_s + POLL_S))
            log.warning("did not listen for %.2f s: stopped, or the event loop was blocked", late_s)

    async def run(self, look: Callable[[], None]) -> None:
        """Call `look` for ever; after a pause leave one look out, so that what was received is taken in first."""
        loop, looked = asyncio.get_running_loop(), True
        self._awake = loop.time(), self._now_s()
        while True:
            asleep_s = loop.time()
            await asyncio.sleep(POLL_S)
            self.note()
            paused = loop.time() - asleep_s > POLL_S + STALL_S
            looked = not (paused and looked)
            if looked:
                look()
