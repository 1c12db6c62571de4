"""What a `Database` stands on: the engine that reads, and whatever commits. Raises what the driver raises."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, Protocol, TypeVar

from sqlalchemy import Connection, Executable, Row, create_engine, event, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine

from skyfolio.api.common import extras
from skyfolio.api.common.settings import TEMPORARY
from skyfolio.api.store.committers import LoopCommitter, ThreadCommitter
from skyfolio.api.store.lease_rows import sessions_of
from skyfolio.api.store.writer import Statement

Result = TypeVar("Result")
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
_LOCK_NAME = text(f"SELECT pg_try_advisory_lock({_LOCK + 3}, hashtext(:name))")
_IDLE_MS = 1_000
"""Milliseconds after which PostgreSQL ends a transaction that its service does not go on with, where several share it:
what a stopped service has locked must not hold up the others."""
_SHARED_SESSIONS = {
    "idle_in_transaction_session_timeout": str(_IDLE_MS),
    "tcp_keepalives_idle": "5",  # a machine that is gone frees its name and its locks
    "tcp_keepalives_interval": "2",
    "tcp_keepalives_count": "3",
}
_RULE = f"must be '{TEMPORARY}', sqlite+aiosqlite:///FILE or postgresql+asyncpg://..."


class Backend(Protocol):
    """One database, as a `Database` needs it. `url` names it."""

    @property
    def url(self) -> URL:
        """Return where it is."""

    async def in_transaction(self, work: Callable[[Connection], Result]) -> Result:
        """Do some work on a connection, and commit it."""
        ...

    async def rows(self, statement: Executable, params: dict[str, Any] | None) -> Sequence[Row[Any]]:
        """Read committed rows."""
        ...

    async def commit(self, statements: list[Statement]) -> None:
        """Execute in one transaction; durable when it returns."""
        ...

    async def shrink(self) -> None:
        """Return the space of deleted rows to the file system, a little at a time."""
        ...

    async def claim(self) -> bool:
        """Lock it for this service, or for those that share it, until `close`; return whether it was free."""
        ...

    async def close(self) -> None:
        """Release it."""
        ...


class EngineBackend:
    """SQLite in a file, or PostgreSQL. Raises ValueError for any other URL, MissingExtraError without the driver.

    shared_as: the name of this service, if several use it, which must be PostgreSQL.
    """

    def __init__(self, url: str, *, shared_as: str | None = None) -> None:
        self._shared_as = shared_as
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if url == TEMPORARY:
            self._folder = tempfile.TemporaryDirectory(prefix="skyfolio-")
            url = f"sqlite+aiosqlite:///{self._folder.name}/skyfolio.db"
        self.engine = _engine(url, shared_as)
        self._sink = _sink(self.engine)
        self.lock: IO[str] | None = None
        """The locked file beside an SQLite database."""
        self._claim: AsyncConnection | None = None

    @property
    def url(self) -> URL:
        """Return where it is."""
        return self.engine.url

    async def in_transaction(self, work: Callable[[Connection], Result]) -> Result:
        """Do some work on a connection, and commit it."""
        async with self.engine.begin() as connection:
            return await connection.run_sync(work)

    async def rows(self, statement: Executable, params: dict[str, Any] | None) -> Sequence[Row[Any]]:
        """Read committed rows."""
        async with self.engine.connect() as connection:
            return (await connection.execute(statement, params)).all()

    async def commit(self, statements: list[Statement]) -> None:
        """Execute in one transaction; durable when it returns."""
        await self._sink.commit(statements)

    async def shrink(self) -> None:
        """Return the space of deleted rows to the file system, a little at a time."""
        if self.url.get_backend_name() == "postgresql":
            return
        async with self.engine.connect() as connection:
            driver = (await connection.get_raw_connection()).driver_connection
            assert driver is not None  # noqa: S101 - for the type checker
            await driver.executescript(f"PRAGMA incremental_vacuum({SHRINK_PAGES})")  # a script runs to its end

    async def claim(self) -> bool:
        """Lock it for this service, or for those that share it, until `close`; return whether it was free."""
        if self.url.get_backend_name() != "postgresql":
            return self._lock_file()
        self._claim = await self.engine.connect()
        kind = "" if self._shared_as is None else "_shared"
        free = bool((await self._claim.execute(text(f"SELECT pg_try_advisory_lock{kind}({_LOCK})"))).scalar())
        if free and self._shared_as is not None:  # two services of one name would end each other's plans
            name = {"name": self._shared_as}
            free = bool((await self._claim.execute(_LOCK_NAME, name)).scalar())
        await self._claim.commit()  # the lock belongs to the session and outlives the transaction
        if not free:
            await self._claim.close()
        return free

    def _lock_file(self) -> bool:
        """Lock the file beside the SQLite database. Return whether it was free; the lock ends with the process."""
        lock = Path(f"{self.url.database}.lock")
        _make_private(lock)
        opened = lock.open("w")
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            opened.close()
            return False
        self.lock = opened
        return True

    async def close(self) -> None:
        """Release it."""
        await self._sink.close()
        if self._claim is not None:
            await self._claim.close()
        await self.engine.dispose()
        if self.lock is not None:
            fcntl.flock(self.lock, fcntl.LOCK_UN)  # a process that is being forked holds a copy of the descriptor
            self.lock.close()
        if self._folder is not None:
            self._folder.cleanup()


def _sink(engine: AsyncEngine) -> ThreadCommitter | LoopCommitter:
    if engine.dialect.name == "postgresql":
        return LoopCommitter(engine)
    sync_engine = create_engine(engine.url.set(drivername="sqlite"))
    event.listen(sync_engine, "connect", _set_pragmas)
    return ThreadCommitter(sync_engine)


def _engine(url: str, shared_as: str | None) -> AsyncEngine:
    parts = make_url(url)
    if parts.get_backend_name() == "sqlite":
        if parts.drivername != "sqlite+aiosqlite" or parts.database in {None, "", ":memory:"}:
            raise ValueError(_RULE)
        _make_private(Path(str(parts.database)))
        engine = create_async_engine(parts, pool_size=8, max_overflow=8)
        event.listen(engine.sync_engine, "connect", _set_pragmas)
        return engine
    if parts.drivername != "postgresql+asyncpg":
        raise ValueError(_RULE)
    extras.require("asyncpg", "database_url: PostgreSQL")
    server_settings = {}
    if shared_as is not None:
        server_settings = {**_SHARED_SESSIONS, "application_name": sessions_of(shared_as)}
    return create_async_engine(
        parts, pool_size=8, max_overflow=8, pool_pre_ping=True, connect_args={"server_settings": server_settings}
    )


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
