"""A disk in memory with the database of a service on it. It outlives the service, and is slow or full on demand."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, Executable, Row, create_engine
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import OperationalError
from sqlalchemy.pool import StaticPool

from skyfolio.api.store.migrate import upgrade
from skyfolio.api.store.writer import Statement, is_passing

Result = TypeVar("Result")
COMMIT_S, READ_S = 0.002, 0.0005
"""Virtual seconds that a commit and a read take on a healthy disk."""
FOLDER_PREFIX = "skyfolio-virtual-"
"""Of the real folder in which files of a disk are."""


class Disk:
    """An SQLite database with all tables, and a folder for what the database does not accept."""

    def __init__(self) -> None:
        self.commit_s = COMMIT_S
        """Virtual seconds that a commit takes."""
        self.refuses: str | None = None
        """Why nothing can be written, as SQLite words it; None while the disk works."""
        self.denied: list[str] = []
        """What the database has refused for good, such as a number that is given twice or an unknown column."""
        self.commits = 0
        self.engine = _engine()
        raw = self.engine.raw_connection()
        try:
            driver = raw.driver_connection
            assert isinstance(driver, sqlite3.Connection)  # noqa: S101
            driver.deserialize(_empty())
            driver.execute("PRAGMA foreign_keys=ON")
            driver.create_function("pg_advisory_xact_lock", 1, lambda _number: None)  # a commit is never interrupted
        finally:
            raw.close()
        self.connection = self.engine.connect()
        """What the services of this disk read and write through."""
        self._folder = tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX)
        self.folder = Path(self._folder.name)

    def save(self, path: Path) -> None:
        """Write the database into an SQLite file that a service opens; without the vehicles, which no longer exist."""
        raw = self.engine.raw_connection()
        try:
            driver = raw.driver_connection
            assert isinstance(driver, sqlite3.Connection)  # noqa: S101
            with closing(sqlite3.connect(path)) as file:
                driver.backup(file)
                file.execute("DELETE FROM vehicles")
                file.commit()
        finally:
            raw.close()

    def held_lines(self) -> int:
        """Return how many transactions local files hold because the database did not accept them."""
        return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in self.folder.iterdir())

    def held_rows(self, table: str) -> list[dict[str, Any]]:
        """Return the rows that local files hold for a table because the database did not accept them."""
        return [
            row
            for file in self.folder.iterdir()
            for line in file.read_text(encoding="utf-8").splitlines()
            for sql, rows, *_ in json.loads(line)
            if sql.startswith(f"INSERT INTO {table} ")
            for row in rows
        ]

    def close(self) -> None:
        """Forget everything."""
        self.connection.close()
        self.engine.dispose()
        self._folder.cleanup()


class Line:
    """The way from a service to its disk, which may be cut: then nothing passes until it is mended."""

    def __init__(self) -> None:
        self._mended: asyncio.Event | None = None

    def cut(self) -> None:
        """Let nothing pass from now on."""
        self._mended = self._mended or asyncio.Event()

    def mend(self) -> None:
        """Let what waits pass."""
        mended, self._mended = self._mended, None
        if mended is not None:
            mended.set()

    async def passed(self) -> None:
        """Return once something can pass."""
        if self._mended is not None:
            await self._mended.wait()


class MemoryBackend:
    """The database on a disk, as one service has it open; nothing is answered once that service is dead.

    A commit happens in the middle of the time that it takes, so that a service may die on either side of it.
    """

    def __init__(self, disk: Disk, alive: Callable[[], bool], line: Line) -> None:
        self._disk, self._alive, self._line = disk, alive, line
        self.url: URL = make_url("sqlite+aiosqlite:///in-memory")

    async def in_transaction(self, work: Callable[[Connection], Result]) -> Result:
        """Do some work on a connection, and commit it."""
        await self._pass(READ_S)
        with self._disk.connection.begin():
            return work(self._disk.connection)

    async def rows(self, statement: Executable, params: dict[str, Any] | None) -> Sequence[Row[Any]]:
        """Read committed rows."""
        await self._pass(READ_S)
        with self._disk.connection.begin():
            return self._disk.connection.execute(statement, params).all()

    async def commit(self, statements: list[Statement]) -> None:
        """Execute in one transaction."""
        half_s = self._disk.commit_s / 2
        await self._pass(half_s)
        if self._disk.refuses is not None:
            raise OperationalError("COMMIT", {}, sqlite3.OperationalError(self._disk.refuses))
        self._disk.commits += 1
        try:
            with self._disk.connection.begin():
                for statement, params in statements:
                    self._disk.connection.execute(statement, params or None)
        except Exception as error:
            if not is_passing(error):
                self._disk.denied.append(str(getattr(error, "orig", None) or error))
            raise
        await self._pass(half_s)

    async def shrink(self) -> None:
        """Do nothing: memory has no file to shrink."""

    async def claim(self) -> bool:
        """Return true: the ground sees to it that two services live at once only where they share the disk."""
        return True

    async def close(self) -> None:
        """Do nothing: the disk stays."""

    async def _pass(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        await self._line.passed()
        if not self._alive():
            await asyncio.get_running_loop().create_future()  # a dead process is never answered


def _memory() -> Any:
    return sqlite3.connect(":memory:", check_same_thread=False)


@cache
def _first() -> Engine:
    """Return an engine whose dialect, and the statements that it has compiled, all disks share."""
    engine = create_engine("sqlite://", poolclass=StaticPool, creator=_memory)
    with engine.connect():
        return engine


_compiled: dict[Any, Any] = {}


def _engine() -> Engine:
    first = _first()
    return Engine(StaticPool(_memory), first.dialect, first.url).execution_options(compiled_cache=_compiled)


@cache
def _empty() -> bytes:
    """Return a database with all tables and no rows; migrated once for all disks."""
    engine = _engine()
    with engine.begin() as connection:
        upgrade(connection)
    raw = engine.raw_connection()
    try:
        driver = raw.driver_connection
        assert isinstance(driver, sqlite3.Connection)  # noqa: S101
        return driver.serialize()
    finally:
        raw.close()
        engine.dispose()
