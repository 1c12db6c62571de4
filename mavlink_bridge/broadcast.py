"""Events for several listeners, each of which gets all of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Generic, TypeVar

Event = TypeVar("Event")


class Broadcast(Generic[Event]):
    """Hands each event to everybody who listens. Lives on the event loop."""

    def __init__(self) -> None:
        self._queues: list[asyncio.Queue[Event | None]] = []

    def listen(self) -> AsyncGenerator[Event, None]:
        """Return the events from this call on, until `close`."""
        queue: asyncio.Queue[Event | None] = asyncio.Queue()
        self._queues.append(queue)
        return self._drain(queue)

    def send(self, event: Event) -> None:
        """Hand an event to everybody who listens."""
        for queue in self._queues:
            queue.put_nowait(event)

    def close(self) -> None:
        """End every iterator that `listen` returned."""
        for queue in self._queues:
            queue.put_nowait(None)

    async def _drain(self, queue: asyncio.Queue[Event | None]) -> AsyncGenerator[Event, None]:
        try:
            while (event := await queue.get()) is not None:
                yield event
        finally:
            self._queues.remove(queue)
