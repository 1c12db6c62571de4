"""What the fleet reaches the world through: the link to vehicles, and the guard that outlives this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from skyfolio.mavlink_bridge.guard import Guard, Orders
from skyfolio.mavlink_bridge.ports import LinkPorts


class GuardPort(Protocol):
    """What speaks for a service that died while it streamed; `mavlink_bridge.guard.Guard` is the one of its own."""

    async def start(self) -> None:
        """Begin to wait. Raises GuardFailed."""

    def orders(self, orders: Orders | None) -> None:
        """Set what to do if this service dies, from now on. Raises GuardFailed."""

    async def close(self) -> None:
        """End it; it does nothing else."""


@dataclass(frozen=True, kw_only=True)
class FleetPorts:
    """link: what the link is made of. guard: makes a guard, not started yet."""

    link: LinkPorts = field(default_factory=LinkPorts)
    guard: Callable[[], GuardPort] = Guard
