"""Delivery: what comes after a hook's number is sent to its receiver, in order, until it has answered with 2xx."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import httpx2
import structlog
from pydantic import BaseModel
from sqlalchemy import select

from skyfolio.api.common.errors import NotFoundError
from skyfolio.api.common.surroundings import utc_now, utc_s
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.event_log import Event, EventLog
from skyfolio.api.store.tables import events as table
from skyfolio.api.webhooks.hooks import Hook, Hooks
from skyfolio.api.webhooks.signing import headers_of
from skyfolio.api.webhooks.topics import KINDS, Topic, topic_of

log = structlog.get_logger()
TIMEOUT_S = 5.0
"""A receiver that has not answered by then has not taken the delivery."""
FIRST_RETRY_S, LONGEST_RETRY_S = 1.0, 600.0
GIVE_UP_S = 86_400.0
"""A delivery that was sent in vain for so long is given up, and the next one is sent."""
AGAIN_S = 5.0
"""How soon a look at the database is repeated that failed, and how often several services look for new hooks."""
PAGE = 100


class Answer(NamedTuple):
    """What a receiver answered: its HTTP status, or what went wrong instead."""

    status: int | None
    error: str | None = None

    @property
    def taken(self) -> bool:
        """Return whether it has the delivery."""
        return self.status is not None and 200 <= self.status < 300


Post = Callable[[str, bytes, Mapping[str, str]], Awaitable[Answer]]
"""Sends a body with headers to an address. Never raises for what the receiver or the network does."""


class WebhookTrial(BaseModel):
    """How a test went: whether the receiver took it, its HTTP status, or what went wrong instead."""

    delivered: bool
    status: int | None
    error: str | None


async def post(url: str, body: bytes, headers: Mapping[str, str]) -> Answer:
    """Send a request; redirects are not followed."""
    try:
        async with httpx2.AsyncClient(timeout=TIMEOUT_S, follow_redirects=False, trust_env=False) as http:
            answer = await http.post(url, content=body, headers=dict(headers))
    except (httpx2.HTTPError, httpx2.InvalidURL, OSError) as error:
        return Answer(None, type(error).__name__)
    return Answer(answer.status_code)


class Deliveries:
    """Tells every hook what it asked for. `run` for ever, as one task; each hook has one delivery at a time."""

    def __init__(self, hooks: Hooks, events: EventLog, database: Database, send: Post = post) -> None:
        self._hooks, self._events, self._database, self._send = hooks, events, database, send
        self._news = asyncio.Event()
        self._listening = True
        self._sending: dict[str, asyncio.Task[bool]] = {}
        self._again: set[str] = set()
        """Hooks for which something may have come while something was sent to them."""
        events.listeners.append(self._note)

    def wake(self) -> None:
        """Look again now: a hook is new."""
        self._news.set()

    async def run(self) -> None:
        """Deliver until cancelled."""
        try:
            while True:
                self._news.clear()
                wait_s = await self._look()
                with suppress(TimeoutError):
                    async with asyncio.timeout(wait_s):
                        await self._news.wait()
        finally:
            for task in self._sending.values():
                task.cancel()
            await asyncio.gather(*self._sending.values(), return_exceptions=True)

    async def test(self, hook_id: str) -> WebhookTrial:
        """Send a delivery of the topic `test` now, and return how that went. Raises NotFoundError, StoreError."""
        hook = await self._hooks.get(hook_id)
        event = Event(id=0, at=utc_now(), kind="test", data={"webhook_id": hook_id})
        answer = await self._deliver(hook, event, Topic.TEST)
        return WebhookTrial(delivered=answer.taken, status=answer.status, error=answer.error)

    def _note(self, event: Event) -> None:
        if self._listening and event.kind in KINDS:
            self._news.set()

    async def _look(self) -> float | None:
        """Begin what is due; return the seconds until something else is, None when only news can change that."""
        try:
            hooks = await self._hooks.all()
        except StoreError:  # the service says so in /ready; nothing is lost, the next look finds it
            return AGAIN_S
        self._listening = bool(hooks)
        waits_s = [AGAIN_S] if self._database.leases is not None else []
        for hook in hooks:
            left_s = hook.view.next_at - utc_s()
            if hook.view.id in self._sending:
                self._again.add(hook.view.id)
                continue
            if left_s > 0:
                waits_s.append(left_s)
                continue
            task = asyncio.create_task(self._catch_up(hook), name=f"webhook-{hook.view.id}")
            self._sending[hook.view.id] = task
            task.add_done_callback(partial(self._sent, hook.view.id))
        return min(waits_s, default=None)

    def _sent(self, hook_id: str, task: asyncio.Task[bool]) -> None:
        del self._sending[hook_id]
        if task.cancelled():
            return
        error = task.exception()
        if isinstance(error, NotFoundError):
            return  # it was deleted meanwhile
        if error is not None:
            log.error("webhook", id=hook_id, error=f"{type(error).__name__}: {error}")
            asyncio.get_running_loop().call_later(AGAIN_S, self._news.set)
        elif hook_id in self._again or not task.result():
            self._news.set()
        self._again.discard(hook_id)

    async def _catch_up(self, hook: Hook) -> bool:
        """Send what this hook has not had yet; return False if its receiver does not take one."""
        cursor = hook.view.cursor
        while found := await self._after(cursor):
            for event in found:
                cursor, topic = event.id, topic_of(event.kind, event.data)
                if topic is None or topic not in hook.view.topics:
                    continue
                if not await self._hooks.claim(hook.view, utc_s() + 2 * TIMEOUT_S):
                    return True
                answer = await self._deliver(hook, event, topic)
                if not await self._noted(hook, event, answer):
                    return False
                hook = await self._hooks.get(hook.view.id)
        return True

    async def _after(self, cursor: int) -> list[Event]:
        asked = select(table).where(table.c.id > cursor, table.c.kind.in_(KINDS)).order_by(table.c.id).limit(PAGE)
        rows = await self._database.rows(asked)
        return [Event(id=row.id, at=row.at, kind=row.kind, data=json.loads(row.data)) for row in rows]

    async def _noted(self, hook: Hook, event: Event, answer: Answer) -> bool:
        """Store how a delivery went; return whether the next one may be sent."""
        view, now = hook.view, utc_s()
        told = {"last_status": answer.status, "last_error": answer.error}
        since = now if view.trying_since is None else view.trying_since
        given_up = not answer.taken and now - since >= GIVE_UP_S
        if answer.taken or given_up:
            done = {"cursor": event.id, "attempts": 0, "trying_since": None, "next_at": 0.0}
            await self._hooks.note(view.id, **done, **told, abandoned=view.abandoned + given_up)
            log.info("webhook", id=view.id, number=event.id, status=answer.status, given_up=given_up)
            return True
        wait_s = min(FIRST_RETRY_S * 2.0 ** min(view.attempts, 20), LONGEST_RETRY_S)
        again = {"attempts": view.attempts + 1, "trying_since": since, "next_at": now + wait_s}
        await self._hooks.note(view.id, **again, **told)
        log.warning("webhook", id=view.id, number=event.id, status=answer.status, error=answer.error, again_in_s=wait_s)
        return False

    async def _deliver(self, hook: Hook, event: Event, topic: Topic) -> Answer:
        told = {"topic": topic.value, **event.model_dump(mode="json")}
        body = json.dumps(told, separators=(",", ":")).encode()
        headers = headers_of(hook.secret, f"{hook.view.id}.{event.id}", str(int(utc_s())), body)
        return await self._send(hook.view.url, body, headers)
