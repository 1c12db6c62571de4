"""One service on the ground: what belongs to it alone, and what is left once it is dead."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextvars import Context
from dataclasses import dataclass, field
from typing import Any, TypeVar

from skyfolio.api.lab.virtual.disk import Line
from skyfolio.api.lab.virtual.guards import MemoryGuard
from skyfolio.api.lab.virtual.loop import Life
from skyfolio.api.lab.virtual.wire import MemoryEndpoint, Port
from skyfolio.api.service import Service
from skyfolio.mavlink_bridge.guard import Orders
from skyfolio.mavlink_bridge.links import OnFrames

Result = TypeVar("Result")


@dataclass(eq=False, kw_only=True)
class Running:
    """A service that was started, None once it is dead or about to be.

    port: where it receives what the fleet sends; its place is also that of the service. line, lease_line: its ways to
    the disk.
    """

    life: Life
    context: Context
    port: Port
    line: Line = field(default_factory=Line)
    lease_line: Line = field(default_factory=Line)
    service: Service | None = None
    _guards: list[MemoryGuard] = field(default_factory=list)

    def is_alive(self) -> bool:
        """Return whether it still runs."""
        return not self.life.over

    def begin(self, work: Coroutine[Any, Any, Result]) -> asyncio.Task[Result]:
        """Begin some work as part of it."""
        return asyncio.get_running_loop().create_task(work, context=self.context.copy())

    def endpoint(self, url: str, on_frames: OnFrames) -> MemoryEndpoint:
        """Return its end of a link."""
        return MemoryEndpoint(self.port, url, on_frames, alive=self.is_alive)

    def new_guard(self) -> MemoryGuard:
        """Return a guard that speaks for it once it is dead."""
        guard = MemoryGuard(self.is_alive)
        self._guards.append(guard)
        return guard

    def die(self) -> list[Orders]:
        """End it: nothing of it has an effect from now on. Return what its guards have to do now."""
        self.life.over = True
        guards, self._guards = self._guards, []
        return [orders for orders in (guard.orphaned() for guard in guards) if orders is not None]
