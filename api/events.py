"""The event log: everything that happened, in order, with a number each; a client can resume after any number."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from typing import Any

from pydantic import BaseModel


class Event(BaseModel):
    """One thing that happened. `id` grows by one; `at` is UTC."""

    id: int
    at: datetime
    kind: str
    data: dict[str, Any]


class EventLog:
    """The last `keep` events in memory, and a wake-up for those who follow."""

    def __init__(self, keep: int = 10_000) -> None:
        self._events: deque[Event] = deque(maxlen=keep)
        self._next = 1
        self._news = asyncio.Event()

    def add(self, kind: str, **data: Any) -> Event:
        """Append an event and wake the followers."""
        event = Event(id=self._next, at=datetime.now(UTC), kind=kind, data=data)
        self._next += 1
        self._events.append(event)
        news, self._news = self._news, asyncio.Event()
        news.set()
        return event

    def after(self, last_id: int) -> list[Event]:
        """The kept events with a greater id, oldest first."""
        return [event for event in self._events if event.id > last_id]

    async def follow(self, last_id: int = 0) -> AsyncIterator[Event]:
        """The events after `last_id`, and then each new one as it comes."""
        while True:
            news = self._news
            for event in self.after(last_id):
                last_id = event.id
                yield event
            await news.wait()
