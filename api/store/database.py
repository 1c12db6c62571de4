"""The database: opening, migrating, claiming, reading and writing it."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Sequence
from typing import Any

import structlog
from sqlalchemy import Executable, Row
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from skyfolio.api.store.backend import Backend, EngineBackend
from skyfolio.api.store.errors import StoreError
from skyfolio.api.store.leases import Leases
from skyfolio.api.store.migrate import upgrade
from skyfolio.api.store.spill import Spill
from skyfolio.api.store.writer import Statement, Writer

log = structlog.get_logger()


class Database:
    """The writer of one database, and its readers. Create it with `await Database.open(url)`, and end it with `close`.

    spill: the local file for what the database does not accept. leases: which operations this service acts for, where
    several services share the database; else None.
    """

    def __init__(self, backend: Backend, spill: Spill, leases: Leases | None = None) -> None:
        self._backend, self._spill, self.leases = backend, spill, leases
        self._writer = Writer(backend.commit, spill)
        self.taken_up = 0
        """Transactions that an earlier process could not store, and that were stored on opening."""

    @classmethod
    async def open(cls, url: str, leases: Leases | None = None) -> Database:
        """Open and migrate. leases: given where several services share it.

        Raises StoreError for a URL or database that cannot be used, MissingExtraError without the PostgreSQL driver.
        """
        try:
            backend = EngineBackend(url, shared_as=None if leases is None else leases.name)
            await backend.in_transaction(upgrade)
        except (SQLAlchemyError, OSError, ValueError) as error:
            raise StoreError(f"database_url: {_without_password(url)} cannot be opened: {error}") from error
        return await cls.on(backend, Spill(backend.url, name="" if leases is None else leases.name), leases)

    @classmethod
    async def on(cls, backend: Backend, spill: Spill, leases: Leases | None = None) -> Database:
        """Open what is migrated already. Raises StoreError when what an earlier process held is still refused."""
        opened = cls(backend, spill, leases)
        await opened._take_up()
        return opened

    async def _take_up(self) -> None:
        """Store what an earlier process could not. Raises StoreError when the database still refuses it."""
        try:
            self.taken_up = await self._backend.in_transaction(self._spill.replay)
        except (SQLAlchemyError, OSError) as error:
            raise StoreError(f"database_url: what an earlier service held cannot be stored: {error}") from error
        await self._spill.clear()

    @property
    def trouble(self) -> str | None:
        """Return why nothing can be stored at present (flights' writes are held), None while the database answers."""
        return self._writer.trouble

    @property
    def held(self) -> int:
        """Return how many transactions of flights wait to be stored."""
        return self._writer.held

    @property
    def is_postgresql(self) -> bool:
        """Return whether this is PostgreSQL; otherwise it is SQLite."""
        return self._backend.url.get_backend_name() == "postgresql"

    async def write(self, *statements: Executable | Statement) -> None:
        """Execute in one transaction, together with what others write now; durable when it returns.

        Raises StoreError when the database refuses; other writes are not affected by that.
        """
        await self.write_soon(*statements)

    def write_soon(self, *statements: Executable | Statement, keep: bool = False) -> asyncio.Future[None]:
        """Write as `write` does, in the order of the calls, without waiting; await the future for durability.

        keep: the write belongs to a flight; it is held, in order, while the database does not answer.
        """
        return self._writer.write_soon(*statements, keep=keep)

    async def keep(self, *statements: Executable | Statement) -> None:
        """Store what belongs to a flight: when it returns, the database has it, or else the local file.

        A flight does not wait for a database that does not answer. Never raises StoreError.
        """
        await self.kept(self.write_soon(*statements, keep=True))

    async def kept(self, done: asyncio.Future[None]) -> None:
        """Wait for a write of a flight as `keep` does.

        Where several services share the database, it waits until the write is durable: the service that takes over must
        find everything that was done. The lease runs out, and the operation with it, if that takes too long.
        """
        await (self._writer.kept(done) if self.leases is None else asyncio.wait({done}))
        if done.done() and not done.cancelled() and (error := done.exception()) is not None:
            log.critical("not stored", error=str(error))

    def owned(self, operation_id: str) -> list[Statement]:
        """Return what begins each transaction with writes of an operation.

        Where several services share the database, it refuses them once another service has the operation.
        """
        return [] if self.leases is None else self.leases.require(operation_id)

    async def rows(self, statement: Executable, params: dict[str, Any] | None = None) -> Sequence[Row[Any]]:
        """Read committed rows. Raises StoreError."""
        try:
            return await self._backend.rows(statement, params)
        except (SQLAlchemyError, OSError) as error:
            raise StoreError(f"read: {error}") from error

    async def shrink(self) -> None:
        """Return the space of deleted rows to the file system, a little at a time. Raises StoreError."""
        try:
            await self._backend.shrink()
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            raise StoreError(f"shrink: {error}") from error

    async def claim(self) -> None:
        """Lock the database for this service, or for all that share it (`several_services`). Raises StoreError.

        Two services that do not divide the operations by leases must not fly the same fleet.
        """
        if not await self._backend.claim():
            hint = "; to share it, set several_services in both, and names that differ" if self.is_postgresql else ""
            raise StoreError(f"database_url: the database is in use by another service{hint}")

    async def close(self) -> None:
        """Finish the writes that wait, and release the database."""
        await self._writer.close()
        await self._backend.close()


def _without_password(url: str) -> str:
    try:
        return make_url(url).render_as_string(hide_password=True)
    except SQLAlchemyError:
        return "the given URL"
