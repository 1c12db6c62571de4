"""API keys, stored as digests, and their three roles.

A viewer reads, a planner also plans, a pilot also flies. Until there is a first key the service is open, which is only
allowed on loopback; revoking the last one closes it, `skyfolio keys reset` opens it again. Keys are 256 random bits, so
a plain digest cannot be inverted.
"""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256

from pydantic import BaseModel
from sqlalchemy import delete, insert, select, update

from skyfolio.api.common.errors import ConflictError, NotFoundError
from skyfolio.api.common.surroundings import monotonic_s, utc_s
from skyfolio.api.store import Database
from skyfolio.api.store.tables import api_keys as table

REMEMBER_S = 1.0
"""A revoked key works at most this long; a new one is known after it."""
RECHECK_S = 0.5
"""How often an open stream checks whether its key is still valid."""
MOST_REMEMBERED = 10_000


class Role(StrEnum):
    """What a key may do; each role includes the one before."""

    VIEWER = "viewer"
    PLANNER = "planner"
    PILOT = "pilot"

    def covers(self, needed: Role) -> bool:
        """Return whether this role includes `needed`."""
        order = list(Role)
        return order.index(self) >= order.index(needed)


@dataclass(frozen=True)
class Principal:
    """Who sends a request."""

    name: str
    role: Role


LOCAL = Principal("local", Role.PILOT)
"""Every client, until there is a key."""


class KeyView(BaseModel):
    """A key as it is stored: without its secret. Times are UTC seconds since 1970."""

    id: str
    name: str
    role: Role
    created_at: float
    revoked_at: float | None


class KeyRing:
    """The keys of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._known: dict[str, tuple[float, Principal | None]] = {}
        self._in_use: tuple[float, bool] = (-REMEMBER_S, False)

    async def create(self, name: str, role: Role) -> str:
        """Create a key and return it; it is shown only this once."""
        key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
        key = f"sky_{key_id}_{secret}"
        row = {"id": key_id, "name": name, "role": role.value, "digest": _digest(key), "created_at": utc_s()}
        await self._database.write((insert(table), row))
        return key

    async def revoke(self, key_id: str) -> None:
        """Revoke a key. Raises NotFoundError."""
        if not await self._database.rows(select(table.c.id).where(table.c.id == key_id)):
            raise NotFoundError(f"key {key_id!r} does not exist")
        await self._database.write(update(table).where(table.c.id == key_id).values(revoked_at=utc_s()))
        self._known.clear()

    async def reset(self) -> int:
        """Delete all keys and return how many there were: everybody on this machine may do everything again.

        Raises ConflictError while one is valid.
        """
        keys = await self.all()
        if working := [key.id for key in keys if key.revoked_at is None]:
            raise ConflictError(f"keys: {', '.join(working)} still work; revoke them first")
        await self._database.write(delete(table))
        self._known.clear()
        return len(keys)

    async def all(self) -> list[KeyView]:
        """Return every key, the oldest first."""
        rows = await self._database.rows(select(table).order_by(table.c.created_at))
        return [KeyView(**{name: getattr(row, name) for name in KeyView.model_fields}) for row in rows]

    async def in_use(self) -> bool:
        """Return whether there ever was a key, even a revoked one: then every request needs a valid key."""
        known_s, answer = self._in_use
        if monotonic_s() - known_s >= REMEMBER_S:
            rows = await self._database.rows(select(table.c.id).limit(1))
            answer = bool(rows)
            self._in_use = (monotonic_s(), answer)
        return answer

    async def identify(self, key: str) -> Principal | None:
        """Return whose key this is, None for one that is unknown or revoked."""
        digest = _digest(key)
        known_s, principal = self._known.get(digest, (-REMEMBER_S, None))
        if monotonic_s() - known_s < REMEMBER_S:
            return principal
        principal = await self._look_up(key, digest)
        if len(self._known) >= MOST_REMEMBERED:
            self._known.clear()
        self._known[digest] = (monotonic_s(), principal)
        return principal

    async def _look_up(self, key: str, digest: str) -> Principal | None:
        parts = key.split("_", 2)
        if len(parts) != 3 or parts[0] != "sky" or not parts[1].isalnum() or len(parts[1]) > 16:
            return None
        rows = await self._database.rows(select(table).where(table.c.id == parts[1], table.c.revoked_at.is_(None)))
        if not rows or not hmac.compare_digest(rows[0].digest, digest):
            return None
        return Principal(rows[0].name, Role(rows[0].role))


def _digest(key: str) -> str:
    return sha256(key.encode("utf-8", "replace")).hexdigest()
