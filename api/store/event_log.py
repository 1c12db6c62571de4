"""The event log: numbered events, in order; a client can resume after any number.

An event is stored before it is sent with its number, so that a number never means two things, whatever is killed when.
While the database does not answer, subscribers receive an event at once, as `provisional` and without a number, and
again with its number when it is stored. Telemetry is different: it is sampled ten times a second while there is a
subscriber, has no number, and is not kept. No subscriber has a queue of its own: all read the same bounded rings, each
at its own pace. A slow subscriber reads events from the database, and misses old telemetry, but never an event.

Where several services share the database, it gives the numbers, in the order of the commits, and each service sends the
events of all of them: its own as soon as they are stored, those of others within `FOLLOW_S`.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, TypeAlias

from fastapi.sse import format_sse_event
from pydantic import BaseModel
from sqlalchemy import func, select, text

from skyfolio.api.common.surroundings import monotonic_s, utc_now
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.tables import events as table

KEEP_EVENTS = 4096
KEEP_TELEMETRY = 32
KEEP_PROVISIONAL = 256
PROVISIONAL = "provisional"
"""SSE event of something that has happened and is not stored yet; its `id` is null, and so is that of the stream."""
PAGE = 500
KEEP_ALIVE = b": keep-alive\n\n"
KEEP_ALIVE_S = 15.0
ASK_AGAIN_S = 0.5
"""How often a stream checks whether it may continue."""
FOLLOW_S = 0.5
"""How often a service looks for the events of others."""
Allowed: TypeAlias = Callable[[], Awaitable[bool]]
_INSERT = table.insert()
_LOCK = text(f"SELECT pg_advisory_xact_lock({0x5C1F0112})")
_INSERT_NEXT = text(
    "INSERT INTO events (id, at, kind, data) "
    "SELECT next, CAST(:at AS double precision), CAST(:kind AS varchar), CAST(:data AS text) "
    "FROM (SELECT coalesce(max(id), 0) + 1 AS next FROM events) AS newest "
    "WHERE NOT EXISTS (SELECT 1 FROM events WHERE id > :after AND at = :at AND kind = :kind AND data = :data)"
)
"""The number is given under a lock that lasts until the commit: numbers become visible in their order. An event whose
commit was not answered is written again, and left out if it is there."""


class Event(BaseModel):
    """Something that happened. `id` grows by one; `at` is UTC."""

    id: int
    at: datetime
    kind: str
    data: dict[str, Any]


class Frame(BaseModel):
    """An event or a telemetry snapshot, encoded once for all subscribers. `number` of telemetry counts snapshots."""

    number: int
    wire: bytes


class EventLog:
    """Appends events and wakes subscribers. Created by `open`, on the event loop that it is used on."""

    def __init__(self, database: Database, last_id: int) -> None:
        self._database = database
        self._last_id = last_id
        self._stored_id = last_id
        self._recent: deque[Frame] = deque(maxlen=KEEP_EVENTS)
        self._snapshots: deque[Frame] = deque(maxlen=KEEP_TELEMETRY)
        self._provisional: deque[Frame] = deque(maxlen=KEEP_PROVISIONAL)
        self._snapshot = self._announced = 0
        self._news = asyncio.Event()
        self._added = asyncio.Event()
        self._followers = 0
        self._ended = False
        self.listeners: list[Callable[[Event], None]] = []

    @classmethod
    async def open(cls, database: Database) -> EventLog:
        """Return the log of this database, ready to continue after its last event."""
        last_id = (await database.rows(select(func.max(table.c.id))))[0][0]
        return cls(database, last_id or 0)

    @property
    def followers(self) -> int:
        """Return how many subscribers there are now."""
        return self._followers

    @property
    def last_id(self) -> int:
        """Return the number of the newest stored event."""
        return self._stored_id

    def add(self, kind: str, **data: Any) -> Event:
        """Append an event; subscribers receive it once it is stored, which is right after.

        Its `id` is 0 where the database gives it later.
        """
        if self._database.leases is not None:
            return self._add_shared(kind, data)
        self._last_id += 1
        event = Event(id=self._last_id, at=utc_now(), kind=kind, data=data)
        row = {"id": event.id, "at": event.at.timestamp(), "kind": kind, "data": json.dumps(data)}
        stored = self._database.write_soon((_INSERT, row), keep=True)
        frame = Frame(number=event.id, wire=_encoded(event))
        stored.add_done_callback(lambda _done: self._publish(event, frame))
        if self._database.trouble is not None:
            self._announce(event)
        return event

    def _add_shared(self, kind: str, data: dict[str, Any]) -> Event:
        """Append an event whose number the database gives."""
        event = Event(id=0, at=utc_now(), kind=kind, data=data)
        row = {"at": event.at.timestamp(), "kind": kind, "data": json.dumps(data), "after": self._stored_id}
        stored = self._database.write_soon((_LOCK, {}), (_INSERT_NEXT, row), keep=True)
        stored.add_done_callback(lambda _done: self._stored_shared(event))
        if self._database.trouble is not None:
            self._announce(event)
        return event

    def _stored_shared(self, event: Event) -> None:
        for listener in self.listeners:
            listener(event)
        self._added.set()

    async def follow_others(self) -> None:
        """Send what is stored, of this service and of the others, until cancelled."""
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(FOLLOW_S):
                    await self._added.wait()
            self._added.clear()
            with suppress(StoreError):  # the next look finds what this one did not
                for event in await self._after(self._stored_id, None):
                    self._stored_id = event.id
                    self._recent.append(Frame(number=event.id, wire=_encoded(event)))
                    self._wake()

    def end(self) -> None:
        """End every stream once it has sent what there is, because the service ends."""
        self._ended = True
        self._wake()

    def _announce(self, event: Event) -> None:
        """Send an event that cannot be stored yet, without the number that it will have."""
        self._announced += 1
        data = json.dumps({**event.model_dump(mode="json"), "id": None})
        self._provisional.append(Frame(number=self._announced, wire=format_sse_event(data_str=data, event=PROVISIONAL)))
        self._wake()

    def publish_telemetry(self, data: Any) -> None:
        """Show telemetry to those who listen now."""
        self._snapshot += 1
        wire = format_sse_event(data_str=json.dumps(data, separators=(",", ":")), event="telemetry")
        self._snapshots.append(Frame(number=self._snapshot, wire=wire))
        self._wake()

    async def after(self, last_id: int, limit: int = PAGE) -> list[Event]:
        """Return stored events with a greater id, oldest first, at most `limit`. Raises StoreError."""
        return await self._after(last_id, self._stored_id, limit)

    async def _after(self, last_id: int, to_id: int | None, limit: int = PAGE) -> list[Event]:
        query = select(table).where(table.c.id > last_id).order_by(table.c.id).limit(limit)
        rows = await self._database.rows(query if to_id is None else query.where(table.c.id <= to_id))
        return [
            Event(id=row.id, at=datetime.fromtimestamp(row.at, UTC), kind=row.kind, data=json.loads(row.data))
            for row in rows
        ]

    async def follow(
        self, last_id: int = 0, *, telemetry: bool = False, forever: bool = True, allowed: Allowed | None = None
    ) -> AsyncIterator[bytes]:
        """Yield server-sent events after `last_id`, then each new one as it comes; an item is one or more whole events.

        telemetry: also snapshots taken from now on. forever: False ends after what is stored now. allowed:
        called again and again; the stream ends when it returns False.
        """
        self._followers += 1
        seen, announced = self._snapshot, self._announced
        asked_s = said_s = monotonic_s()
        try:
            while True:
                now_s = monotonic_s()
                if allowed is not None and now_s - asked_s >= ASK_AGAIN_S:
                    if not await allowed():
                        return
                    asked_s = now_s
                news = self._news
                last_id, wire = await self._since(last_id)
                wire += b"".join(frame.wire for frame in self._provisional if frame.number > announced)
                announced = self._announced
                if telemetry:
                    wire += b"".join(frame.wire for frame in self._snapshots if frame.number > seen)
                    seen = self._snapshot
                if not wire and (self._ended or not forever):
                    return
                if not wire and now_s - said_s >= KEEP_ALIVE_S:
                    wire = KEEP_ALIVE
                if wire:
                    said_s = now_s
                    yield wire
                else:
                    await _pause(news)
        finally:
            self._followers -= 1

    async def _since(self, last_id: int) -> tuple[int, bytes]:
        """Return the next events after `last_id` as sent, and the id of the last of them."""
        if last_id >= self._stored_id:
            return last_id, b""
        if self._recent and self._recent[0].number <= last_id + 1:
            frames = [frame for frame in self._recent if frame.number > last_id]
            return frames[-1].number, b"".join(frame.wire for frame in frames)
        events = await self.after(last_id)
        return (events[-1].id if events else self._stored_id), b"".join(_encoded(event) for event in events)

    def _publish(self, event: Event, frame: Frame) -> None:
        """Send an event that is stored, or that the database has finally refused: the flight goes on either way."""
        self._stored_id = event.id
        self._recent.append(frame)
        for listener in self.listeners:
            listener(event)
        self._wake()

    def _wake(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()


async def _pause(news: asyncio.Event) -> None:
    """Wait for news, but not longer than a subscriber may go unchecked."""
    with suppress(TimeoutError):
        async with asyncio.timeout(ASK_AGAIN_S):
            await news.wait()


def _encoded(event: Event) -> bytes:
    return format_sse_event(data_str=event.model_dump_json(), event=event.kind, id=str(event.id))
