"""What every link is to the hub, and what links share."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Protocol

from skyfolio.mavlink_bridge.framing import Frame

OnFrames = Callable[["Endpoint", list[Frame]], None]
RETRY_S = 1.0
"""Wall seconds before a broken connection is tried again."""
MOST_WAITING_BYTES = 16_384
"""Bytes that may wait for a slow line; whole frames beyond are dropped: an old setpoint is worse than none."""
READ_BYTES = 65536


class Endpoint(Protocol):
    """What the hub needs of a connection."""

    url: str

    async def open(self) -> None:
        """Begin. Raises ConnectionFailed.

        An end that may appear later (a vehicle that is switched on) is no failure.
        """
        ...

    def send(self, frame: bytes, system_id: int) -> None:
        """Send one frame to a vehicle, or to all that were heard here (0); nothing while it is broken. Never waits."""
        ...

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Take in that a component is heard from this address, by a frame that passed every check."""
        ...

    def close(self) -> None:
        """End it for good."""
        ...


MakeEndpoint = Callable[[str, OnFrames], Endpoint]
"""Makes the endpoint that a URL names, not opened yet. Raises ConnectionFailed naming the rule."""


class OneEnd:
    """A link with one other end, where every answer is sent."""

    def place(self, system_id: int, component_id: int, source: Hashable) -> None:
        """Ignore it: there is one address only."""
