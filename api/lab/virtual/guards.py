"""The guards of a service: each waits, as a process of its own does, and speaks for the service once that is dead."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial

from skyfolio.api.lab.virtual.wire import MemoryEndpoint, MemoryMessages, Port
from skyfolio.mavlink_bridge import ConnectionFailed, GuardFailed
from skyfolio.mavlink_bridge.guard import Orders, take_over
from skyfolio.mavlink_bridge.links import OnFrames
from skyfolio.mavlink_bridge.ports import LinkPorts

START_S = 0.4
"""Virtual seconds until a guard takes orders: a Python process starts."""
AWAKE_S = 0.05
"""Virtual seconds from the death of its service until a guard opens the link."""
log = logging.getLogger(__name__)


class MemoryGuard:
    """One guard; a `GuardPort`. alive: returns whether its service still runs."""

    def __init__(self, alive: Callable[[], bool]) -> None:
        self._alive = alive
        self._is_up = False
        self._orders: Orders | None = None

    async def start(self) -> None:
        """Begin to wait."""
        await asyncio.sleep(START_S)
        self._is_up = True

    def orders(self, orders: Orders | None) -> None:
        """Set what to do if the service dies, from now on. Raises GuardFailed before the start and after the end."""
        if not self._is_up:
            raise GuardFailed("the guard process is gone")
        if self._alive():
            self._orders = orders

    async def close(self) -> None:
        """End it; it does nothing else. A service that is dead already has ended nothing."""
        if self._alive():
            self._is_up, self._orders = False, None

    def orphaned(self) -> Orders | None:
        """Return what is to be done now that the service is dead, once; None for nothing."""
        orders, self._orders = self._orders, None
        return orders


async def carry_out(orders: Orders, port: Port, seconds: Callable[[], float], utc_s: Callable[[], float]) -> None:
    """Do as a guard whose service has died, unless somebody else has the port by then. seconds: the machine's clock."""

    def endpoint(url: str, on_frames: OnFrames) -> MemoryEndpoint:
        return MemoryEndpoint(port, url, on_frames, alive=lambda: True)

    await asyncio.sleep(AWAKE_S)
    ports = LinkPorts(endpoint=endpoint, messages=partial(MemoryMessages))
    try:
        failures = await take_over(orders, ports=ports, clock=_Clock(seconds), utc_s=utc_s, boot_s=seconds)
    except ConnectionFailed as error:
        log.warning("left to whoever has the links now: %s", error)
        return
    for system_id, failure in failures.items():
        log.warning("system %d: %s", system_id, failure or "flies its mission")


class _Clock:
    """The clock of a guard."""

    def __init__(self, seconds: Callable[[], float]) -> None:
        self._seconds = seconds

    def now(self) -> float:
        """Return virtual seconds."""
        return self._seconds()
