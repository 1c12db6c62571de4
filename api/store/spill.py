"""A local file for what the database does not accept, so that nothing is lost over a restart.

It holds JSON lines of SQL text, its rows, and a query that finds such a row, in order. It is beside an SQLite database
or, when that disk cannot be written either, in the system's temporary folder. A service that starts stores them first.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Connection, Dialect, Executable, Insert, Table, and_, bindparam, select, text
from sqlalchemy.dialects import sqlite
from sqlalchemy.dialects.postgresql.base import PGDialect
from sqlalchemy.engine import URL
from sqlalchemy.exc import IntegrityError

from skyfolio.api.store.lease_rows import REQUIRE_LEASE
from skyfolio.api.store.writer import Statement

log = structlog.get_logger()
_DIALECTS: dict[str, Dialect] = {
    "sqlite": sqlite.dialect(paramstyle="named"),
    # that of a driver would write casts, which `text` does not understand
    "postgresql": PGDialect(paramstyle="named"),  # type: ignore[no-untyped-call]
}


class Spill:
    """The local file of one database. Blocking work runs in a thread.

    name: of this service, where several on one machine may share the database.
    """

    def __init__(self, url: URL, folders: Sequence[Path] | None = None, name: str = "") -> None:
        self._dialect = _DIALECTS[url.get_backend_name()]
        self._files = [folder / _name(url, name) for folder in (_folders(url) if folders is None else folders)]
        self._file: Path | None = None
        self.error: str | None = None
        """Why the last lines could not be written anywhere, None while they could."""

    async def add(self, transactions: list[list[Statement]]) -> None:
        """Append transactions. Where no file can be written, that is logged, and they are held in memory alone."""
        lines = "".join(
            f"{json.dumps([self._encoded(statement) for statement in statements])}\n" for statements in transactions
        )
        await asyncio.to_thread(self._append, lines)

    async def clear(self) -> None:
        """Delete the file: its transactions are stored."""
        await asyncio.to_thread(self._remove)

    def replay(self, connection: Connection) -> int:
        """Store what an earlier process could not, in its order. Return how many transactions there were.

        Rows that are stored already stay. What belongs to an operation that another service has meanwhile is left out
        (`LeaseRows.required`). The caller commits, and calls `clear` after that.
        """
        count = 0
        for transaction in self._stored():
            count += 1
            for sql, rows, *twin in transaction:
                refused = [row for row in rows if not _is_stored(connection, sql, row, *twin)]
                if refused and sql == REQUIRE_LEASE:
                    break
        return count

    def _append(self, lines: str) -> None:
        candidates = self._files if self._file is None else [self._file]
        for file in candidates:
            try:
                descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
                with os.fdopen(descriptor, "a", encoding="utf-8") as opened:
                    opened.write(lines)
            except OSError as error:
                self.error = f"{file}: {error.strerror or error}"
                continue
            self._file, self.error = file, None
            return
        log.critical("held in memory alone", reason=self.error)

    def _remove(self) -> None:
        self._file = None
        for file in self._files:
            file.unlink(missing_ok=True)

    def _stored(self) -> Iterator[list[tuple[str, list[dict[str, Any]], str | None]]]:
        for file in self._files:
            if not file.is_file() or file.stat().st_uid != os.getuid():
                continue
            for line in file.read_text(encoding="utf-8").splitlines():
                try:
                    yield json.loads(line)
                except ValueError:
                    log.error("an unfinished line of what was held is left out", file=str(file))

    def _encoded(self, statement: Statement) -> tuple[str, list[dict[str, Any]], str | None]:
        executable, params = statement
        rows = params if isinstance(params, list) else [params]
        columns = list(rows[0]) if rows and rows[0] else None
        compiled = executable.compile(dialect=self._dialect, column_keys=columns)  # type: ignore[attr-defined]
        return str(compiled), [compiled.construct_params(row) for row in rows], self._twin(executable, columns or [])

    def _twin(self, executable: Executable, columns: list[str]) -> str | None:
        """Return a query that finds the very row that is inserted, where no key would refuse to store it twice.

        A commit that was not answered, or not before the service was killed, may have been carried out.
        """
        if not isinstance(executable, Insert) or not isinstance(executable.table, Table):
            return None
        given = executable.table.autoincrement_column
        if given is None or given.name in columns:
            return None
        same = (executable.table.c[name].is_not_distinct_from(bindparam(name)) for name in columns)
        return str(select(given).where(and_(*same)).compile(dialect=self._dialect))


def _is_stored(connection: Connection, sql: str, row: dict[str, Any], twin: str | None = None) -> bool:
    """Store one row unless it is there, which the query `twin` finds; return whether it was not refused."""
    if twin is not None and connection.execute(text(twin), row).first() is not None:
        log.warning("left out of what was held", reason="it is stored already")
        return True
    try:
        with connection.begin_nested():
            connection.execute(text(sql), row)
    except IntegrityError as error:  # most likely it was stored before the process ended
        log.warning("left out of what was held", reason=str(error.orig))
        return False
    return True


def _folders(url: URL) -> list[Path]:
    beside = [Path(str(url.database)).parent] if url.get_backend_name() == "sqlite" else []
    return [*beside, Path(tempfile.gettempdir())]


def _name(url: URL, service: str) -> str:
    """Return a file name that is unique to the database, without anything secret."""
    where = f"{url.host}:{url.port}/{url.database}" if url.host else str(Path(str(url.database)).absolute())
    where += f" {service}" if service else ""
    return f"skyfolio-held-{hashlib.sha256(where.encode()).hexdigest()[:16]}.jsonl"
