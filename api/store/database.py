"""Opening the database and writing to it."""

from __future__ import annotations

import asyncio
import fcntl
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, TypeAlias

import structlog
from sqlalchemy import Executable, Row, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine

from api.store.errors import StoreError
from api.store.migrate import upgrade

log = structlog.get_logger()
Params: TypeAlias = dict[str, Any] | list[dict[str, Any]]
Statement: TypeAlias = tuple[Executable, Params]

TEMPORARY = "temporary"
"""Database URL of a service that keeps nothing after it ends."""
_PRAGMAS = (
    "journal_mode=WAL",  # readers never wait for the writer
    "synchronous=NORMAL",  # a killed process loses nothing; a power cut at most the last commits
    "busy_timeout=5000",
    "foreign_keys=ON",
)
MOST_AT_ONCE = 500
_LOCK = 0x5C1F0110
"""Number of the advisory lock that a service holds on PostgreSQL."""


class Database:
    """One engine, one writer. `await Database.open(url)`; `close` when done."""

    def __init__(self, engine: AsyncEngine, folder: tempfile.TemporaryDirectory[str] | None) -> None:
        self._engine, self._folder = engine, folder
        self._waiting: list[tuple[list[Statement], asyncio.Future[None]]] = []
        self._news = asyncio.Event()
        self._lock: IO[str] | None = None
        self._claim: AsyncConnection | None = None
        self._writer = asyncio.create_task(self._write_all(), name="store-writer")

    @classmethod
    async def open(cls, url: str) -> Database:
        """Open and migrate. Raises StoreError for a URL that cannot be used or a database that cannot be reached."""
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
        return cls(engine, folder)

    @property
    def is_postgresql(self) -> bool:
        """Which of the two it is."""
        return self._engine.dialect.name == "postgresql"

    async def write(self, *statements: Executable | Statement) -> None:
        """Execute in one transaction, together with what others write now; durable when it returns.

        Raises StoreError when the database refuses; what others wrote is not touched by that.
        """
        await self.write_soon(*statements)

    def write_soon(self, *statements: Executable | Statement) -> asyncio.Future[None]:
        """As `write`, in the order of the calls, without waiting; await the future to know that it is durable."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        rows = [one if isinstance(one, tuple) else (one, {}) for one in statements]
        self._waiting.append((rows, done))
        self._news.set()
        return done

    async def rows(self, statement: Executable, params: dict[str, Any] | None = None) -> Sequence[Row[Any]]:
        """Read committed rows. Raises StoreError."""
        try:
            async with self._engine.connect() as connection:
                return (await connection.execute(statement, params)).all()
        except (SQLAlchemyError, OSError) as error:
            raise StoreError(f"read: {error}") from error

    async def claim(self) -> None:
        """Be the only service of this database: two services must not fly the same fleet. Raises StoreError."""
        if self.is_postgresql:
            self._claim = await self._engine.connect()
            free = bool((await self._claim.execute(text(f"SELECT pg_try_advisory_lock({_LOCK})"))).scalar())
            await self._claim.commit()  # the lock belongs to the session and outlives the transaction
        else:
            free = self._lock_file()
        if not free:
            raise StoreError("database_url: the database is in use by another service")

    def _lock_file(self) -> bool:
        """Whether the file beside the SQLite database could be locked; the lock dies with the process."""
        self._lock = Path(f"{self._engine.url.database}.lock").open("w")  # noqa: SIM115 - until `close`
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True

    async def close(self) -> None:
        """Finish what waits to be written, and let go of the database."""
        while self._waiting and not self._writer.done():
            await asyncio.wait([self._waiting[-1][1], self._writer], return_when=asyncio.FIRST_COMPLETED)
        self._writer.cancel()
        with suppress(asyncio.CancelledError):
            await self._writer
        if self._claim is not None:
            await self._claim.close()
        await self._engine.dispose()
        if self._lock is not None:
            self._lock.close()
        if self._folder is not None:
            self._folder.cleanup()

    # -- the writer: one commit for all that came while the last one was made -------------------------------------

    async def _write_all(self) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            while self._waiting:
                batch, self._waiting = self._waiting[:MOST_AT_ONCE], self._waiting[MOST_AT_ONCE:]
                await self._commit(batch)

    async def _commit(self, batch: list[tuple[list[Statement], asyncio.Future[None]]]) -> None:
        error = await self._execute([row for rows, _ in batch for row in rows])
        if error is not None and len(batch) > 1:  # find out whose fault it is; the others' writes are good
            for one in batch:
                await self._commit([one])
            return
        for _, done in batch:
            if done.cancelled():
                continue
            if error is None:
                done.set_result(None)
            else:
                done.set_exception(StoreError(f"write: {error}"))
                done.exception()  # seen: whoever does not await it finds it in the log
        if error is not None:
            log.error("write refused", error=str(error))

    async def _execute(self, rows: list[Statement]) -> Exception | None:
        try:
            async with self._engine.begin() as connection:
                for statement, params in _runs(rows):
                    await connection.execute(statement, params or None)
        except (SQLAlchemyError, OSError) as error:
            return error
        return None


def _runs(rows: list[Statement]) -> list[Statement]:
    """Neighbours with the very same statement become one call with many parameter sets."""
    merged: list[tuple[Executable, Any]] = []
    for statement, params in rows:
        given = params if isinstance(params, list) else [params]
        if merged and merged[-1][0] is statement and params:
            merged[-1][1].extend(given)
        else:
            merged.append((statement, list(given) if params else {}))
    return merged


def _engine(url: str) -> AsyncEngine:
    parts = make_url(url)
    if parts.get_backend_name() == "sqlite":
        if parts.drivername != "sqlite+aiosqlite" or parts.database in {None, "", ":memory:"}:
            raise ValueError(f"must be '{TEMPORARY}', sqlite+aiosqlite:///FILE or postgresql+asyncpg://...")
        Path(str(parts.database)).parent.mkdir(parents=True, exist_ok=True)
        engine = create_async_engine(parts, pool_size=8, max_overflow=8)
        event.listen(engine.sync_engine, "connect", _set_pragmas)
        return engine
    if parts.drivername != "postgresql+asyncpg":
        raise ValueError(f"must be '{TEMPORARY}', sqlite+aiosqlite:///FILE or postgresql+asyncpg://...")
    return create_async_engine(parts, pool_size=8, max_overflow=8, pool_pre_ping=True)


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
