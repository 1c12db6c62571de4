"""The port through which the link speaks MAVLink: bytes of vehicles in, messages out, and the other way round.

Its real implementation is MAVSDK (`mavsdk_port`). Whatever else stands in for it passes the same contract tests.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Protocol

from skyfolio.mavlink_bridge.mission_messages import Message

Receive = Callable[[str, dict[str, Any], float], None]
"""Takes the name of a message, its fields by their MAVLink names (None for NaN), and the fleet second of its
arrival."""


class NotSentError(Exception):
    """The link does not take the message; the text says why."""


class MessagePort(Protocol):
    """Our ground station on the link: it also sends our HEARTBEAT, at 1 Hz once a system was heard."""

    def take_in(self, data: bytes) -> None:
        """Take in whole frames that vehicles have sent."""
        ...

    async def systems(self) -> Collection[int]:
        """Return the ids of the systems that were heard so far."""
        ...

    def listen(self, system_id: int, names: Collection[str], receive: Receive) -> None:
        """Hand over each of these messages that the system's autopilot (component 1) sends, on the event loop."""
        ...

    def send(self, system_id: int, message: Message) -> None:
        """Send a message to the autopilot of a system. Raises NotSentError."""
        ...

    async def close(self) -> None:
        """End it: nothing is sent or handed over any more."""
        ...


OpenPort = Callable[[Callable[[], float], Callable[[bytes], object], Callable[[], None]], MessagePort]
"""Opens a port on the running event loop.

It is given what returns fleet seconds and may be called from any thread; what takes the frames to send, as well; and
what is called on the event loop when a new system was heard.
"""
