"""Registered webhooks, in the database."""

from __future__ import annotations

import ipaddress
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from pydantic import BaseModel
from sqlalchemy import Row, delete, func, insert, select, update

from skyfolio.api.common.errors import ConflictError, InvalidError, NotFoundError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.common.surroundings import new_token, utc_s
from skyfolio.api.store import Database
from skyfolio.api.store.tables import webhooks as table
from skyfolio.api.webhooks.topics import Topic

MOST = 32


class WebhookView(BaseModel):
    """A webhook. Its secret is never returned. Times are UTC seconds since 1970.

    cursor: the number of the last event that its receiver has, or that was passed over. attempts: how often the next
    one was sent in vain since `trying_since`; it is sent again at `next_at`. last_status, last_error: of the last
    answer. abandoned: how many deliveries were given up.
    """

    id: str
    url: str
    topics: list[Topic]
    created_at: float
    cursor: int
    attempts: int
    trying_since: float | None
    next_at: float
    last_status: int | None
    last_error: str | None
    abandoned: int


@dataclass(frozen=True, kw_only=True)
class Hook:
    """A webhook with its secret, which is not shown where this is printed."""

    view: WebhookView
    secret: _Hidden


class _Hidden(str):
    """A text that `repr` does not show."""

    __slots__ = ()

    def __repr__(self) -> str:
        return "'...'"


class Hooks:
    """The webhooks of this database. Every method may raise StoreError."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def register(
        self, creation: NewResource, *, url: str, topics: Sequence[Topic], secret: str, after: int
    ) -> WebhookView:
        """Store a webhook that is sent what comes after event number `after`.

        Raises InvalidError for an address that is none, and ConflictError if there are too many.
        """
        require_address(url)
        rows = await self._database.rows(select(table).where(table.c.id == creation.id))
        if rows:
            creation.require_same(rows[0].fingerprint)
            return _view(rows[0])
        if (await self._database.rows(select(func.count()).select_from(table)))[0][0] >= MOST:
            raise ConflictError(f"there are {MOST} webhooks already; delete one")
        values: dict[str, Any] = {
            "id": creation.id,
            "fingerprint": creation.fingerprint,
            "created_at": utc_s(),
            "url": url,
            "topics": json.dumps(sorted(set(topics))),
            "secret": secret,
            "cursor": after,
            "attempts": 0,
            "next_at": 0.0,
            "abandoned": 0,
        }
        await self._database.write((insert(table), values))
        return (await self.get(creation.id)).view

    async def all(self) -> list[Hook]:
        """Return all webhooks, the oldest first."""
        rows = await self._database.rows(select(table).order_by(table.c.created_at, table.c.id))
        return [_hook(row) for row in rows]

    async def get(self, hook_id: str) -> Hook:
        """Return one webhook. Raises NotFoundError."""
        rows = await self._database.rows(select(table).where(table.c.id == hook_id))
        if not rows:
            raise NotFoundError(f"webhook {hook_id!r} does not exist")
        return _hook(rows[0])

    async def delete(self, hook_id: str) -> None:
        """Delete a webhook. Raises NotFoundError."""
        await self.get(hook_id)
        await self._database.write(delete(table).where(table.c.id == hook_id))

    async def claim(self, view: WebhookView, until_s: float) -> bool:
        """Return whether this service may send the next delivery, alone until that UTC second.

        Several services look at the same webhooks; a database of one service always says yes.
        """
        if self._database.leases is None:
            return True
        token = new_token(16)
        mine = (table.c.id == view.id) & (table.c.cursor == view.cursor) & (table.c.next_at == view.next_at)
        await self._database.write(update(table).where(mine).values(claim=token, next_at=until_s))
        return bool(await self._database.rows(select(table.c.id).where(table.c.id == view.id, table.c.claim == token)))

    async def note(self, hook_id: str, **values: Any) -> None:
        """Store how far its deliveries are."""
        await self._database.write(update(table).where(table.c.id == hook_id).values(**values))


def require_address(url: str) -> None:
    """Refuse what is no address of a receiver. Raises InvalidError.

    Receivers are often in the same network, so private addresses are allowed: only pilots register webhooks, redirects
    are not followed, and answers are not returned. Link-local addresses, where clouds keep credentials, are refused.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise InvalidError(f"url: it is not a URL: {error}") from error
    if parts.scheme not in {"http", "https"} or not host:
        raise InvalidError("url: it must begin with https:// or http:// and name a host")
    if parts.username is not None or parts.password is not None:
        raise InvalidError("url: it must not hold a user name or password; deliveries are signed")
    with suppress(ValueError):
        if ipaddress.ip_address(host).is_link_local:
            raise InvalidError("url: link-local addresses are refused")


def _hook(row: Row[Any]) -> Hook:
    return Hook(view=_view(row), secret=_Hidden(row.secret))


def _view(row: Row[Any]) -> WebhookView:
    known = {name: getattr(row, name) for name in WebhookView.model_fields if name != "topics"}
    return WebhookView(topics=json.loads(row.topics), **known)
