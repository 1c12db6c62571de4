"""The database: opening, migrating, claiming, reading and writing it."""

from __future__ import annotations

import asyncio
import fcntl
import os
import sqlite3
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import structlog
from sqlalchemy import Executable, Row, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine

from skyfolio.api.common import extras
from skyfolio.api.common.settings import TEMPORARY
from skyfolio.api.store.errors import StoreError
from skyfolio.api.store.migrate import upgrade
from skyfolio.api.store.spill import Spill
from skyfolio.api.store.writer import LoopCommitter, Statement, ThreadCommitter, Writer

log = structlog.get_logger()
LOOK_EVERY_S = 0.1
"""How often a flight that waits for its write checks whether the database still answers."""
SHRINK_PAGES = 2_000
_PRAGMAS = (
    "auto_vacuum=INCREMENTAL",  # takes effect in a new file
    "journal_mode=WAL",  # readers never wait for the writer
    "synchronous=NORMAL",  # a killed process loses nothing; a power cut at most the last commits
    "busy_timeout=5000",
    "foreign_keys=ON",
)
_LOCK = 0x5C1F0110
"""Number of the advisory lock that a service holds on PostgreSQL."""


class Database:
    """The engine and the writer of one database. Create it with `await Database.open(url)`, and end it with `close`."""

    def __init__(self, engine: AsyncEngine, folder: tempfile.TemporaryDirectory[str] | None) -> None:
        self._engine, self._folder = engine, folder
        self._sink = _sink(engine)
        self._spill = Spill(engine.url)
        self._writer = Writer(self._sink.commit, self._spill)
        self.taken_up = 0
        """Transactions that an earlier process could not store, and that were stored on opening."""
        self._lock: IO[str] | None = None
        self._claim: AsyncConnection | None = None

    @classmethod
    async def open(cls, url: str) -> Database:
        """Open and migrate.

        Raises StoreError for a URL or database that cannot be used, MissingExtraError without the PostgreSQL driver.
        """
        folder = None
        if url == TEMPORARY:
            folder = tempfile.TemporaryDirectory(prefix="skyfolio-")
            url = f"sqlite+aiosqlite:///{folder.name}/skyfolio.db"
        try:
            engine = _engine(url)
            async with engine.begin() as connection:
                await connection.run_sync(upgrade)
        except (SQLAlchemyError, OSError, ValueError) as error:
            raise StoreError(f"database_url: {_without_password(url)} cannot be opened: {error}") from error
        opened = cls(engine, folder)
        await opened._take_up()
        return opened

    async def _take_up(self) -> None:
        """Store what an earlier process could not. Raises StoreError when the database still refuses it."""
        try:
            async with self._engine.begin() as connection:
                self.taken_up = await connection.run_sync(self._spill.replay)
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
        return self._engine.dialect.name == "postgresql"

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
        """Store what belongs to a flight: durable when it returns, or held if the database does not answer.

        Waits for the database only as long as it answers: a flight must not wait for it. Never raises
        StoreError.
        """
        await self.kept(self.write_soon(*statements, keep=True))

    async def kept(self, done: asyncio.Future[None]) -> None:
        """Wait for a write of a flight as `keep` does."""
        while not done.done() and self.trouble is None:
            await asyncio.wait({done}, timeout=LOOK_EVERY_S)
        if done.done() and not done.cancelled() and (error := done.exception()) is not None:
            log.critical("not stored", error=str(error))

    async def rows(self, statement: Executable, params: dict[str, Any] | None = None) -> Sequence[Row[Any]]:
        """Read committed rows. Raises StoreError."""
        try:
            async with self._engine.connect() as connection:
                return (await connection.execute(statement, params)).all()
        except (SQLAlchemyError, OSError) as error:
            raise StoreError(f"read: {error}") from error

    async def shrink(self) -> None:
        """Return the space of deleted rows to the file system, a little at a time. Raises StoreError."""
        if self.is_postgresql:
            return
        try:
            async with self._engine.connect() as connection:
                driver = (await connection.get_raw_connection()).driver_connection
                assert driver is not None  # noqa: S101 - for the type checker
                await driver.executescript(f"PRAGMA incremental_vacuum({SHRINK_PAGES})")  # a script runs to its end
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            raise StoreError(f"shrink: {error}") from error

    async def claim(self) -> None:
        """Lock the database for this service: two services must not fly the same fleet. Raises StoreError."""
        if self.is_postgresql:
            self._claim = await self._engine.connect()
            free = bool((await self._claim.execute(text(f"SELECT pg_try_advisory_lock({_LOCK})"))).scalar())
            await self._claim.commit()  # the lock belongs to the session and outlives the transaction
        else:
            free = self._lock_file()
        if not free:
            raise StoreError("database_url: the database is in use by another service")

    def _lock_file(self) -> bool:
        """Lock the file beside the SQLite database. Return whether it was free; the lock ends with the process."""
        lock = Path(f"{self._engine.url.database}.lock")
        _make_private(lock)
        opened = lock.open("w")
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            opened.close()
            return False
        self._lock = opened
        return True

    async def close(self) -> None:
        """Finish the writes that wait, and release the database."""
        await self._writer.close()
        await self._sink.close()
        if self._claim is not None:
            await self._claim.close()
        await self._engine.dispose()
        if self._lock is not None:
            fcntl.flock(self._lock, fcntl.LOCK_UN)  # a process that is being forked holds a copy of the descriptor
            self._lock.close()
        if self._folder is not None:
            self._folder.cleanup()


def _sink(engine: AsyncEngine) -> ThreadCommitter | LoopCommitter:
    if engine.dialect.name == "postgresql":
        return LoopCommitter(engine)
    sync_engine = create_engine(engine.url.set(drivername="sqlite"))
    event.listen(sync_engine, "connect", _set_pragmas)
    return ThreadCommitter(sync_engine)


def _engine(url: str) -> AsyncEngine:
    parts = make_url(url)
    if parts.get_backend_name() == "sqlite":
        if parts.drivername != "sqlite+aiosqlite" or parts.database in {None, "", ":memory:"}:
            raise ValueError(f"must be '{TEMPORARY}', sqlite+aiosqlite:///FILE or postgresql+asyncpg://...")
        _make_private(Path(str(parts.database)))
        engine = create_async_engine(parts, pool_size=8, max_overflow=8)
        event.listen(engine.sync_engine, "connect", _set_pragmas)
        return engine
    if parts.drivername != "postgresql+asyncpg":
        raise ValueError(f"must be '{TEMPORARY}', sqlite+aiosqlite:///FILE or postgresql+asyncpg://...")
    extras.require("asyncpg", "database_url: PostgreSQL")
    return create_async_engine(parts, pool_size=8, max_overflow=8, pool_pre_ping=True)


def _make_private(file: Path) -> None:
    """Make the file readable by its owner alone, creating it if needed. SQLite's -wal and -shm files follow it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    os.close(os.open(file, os.O_CREAT | os.O_RDWR, 0o600))
    if file.stat().st_uid == os.geteuid():
        file.chmod(0o600)


def _set_pragmas(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    for pragma in _PRAGMAS:
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _without_password(url: str) -> str:
    try:
        return make_url(url).render_as_string(hide_password=True)
    except SQLAlchemyError:
        return "the given URL"
