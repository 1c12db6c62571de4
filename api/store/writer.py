"""One writer for the whole service: one commit for all that came while the last one was made."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias

import structlog
from sqlalchemy import Engine, Executable
from sqlalchemy.ext.asyncio import AsyncEngine

from api.store.errors import StoreError

log = structlog.get_logger()
Params: TypeAlias = dict[str, Any] | list[dict[str, Any]]
Statement: TypeAlias = tuple[Executable, Params]
Commit: TypeAlias = Callable[[list[Statement]], Awaitable[None]]
"""Executes statements in one transaction; raises whatever the database says."""
MOST_AT_ONCE = 500


class Writer:
    """Keeps the order of the calls. Made on the event loop that it is used on."""

    def __init__(self, commit: Commit) -> None:
        self._commit_all = commit
        self._waiting: list[tuple[list[Statement], asyncio.Future[None]]] = []
        self._news = asyncio.Event()
        self._ending = False
        self._task = asyncio.create_task(self._write_all(), name="store-writer")

    def write_soon(self, *statements: Executable | Statement) -> asyncio.Future[None]:
        """Queue one transaction; the future ends when it is durable, or with StoreError when it is refused."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append(([one if isinstance(one, tuple) else (one, {}) for one in statements], done))
        self._news.set()
        return done

    async def close(self) -> None:
        """Finish what waits."""
        self._ending = True
        self._news.set()
        await self._task

    async def _write_all(self) -> None:
        while self._waiting or not self._ending:
            await self._news.wait()
            self._news.clear()
            while self._waiting:
                batch, self._waiting = self._waiting[:MOST_AT_ONCE], self._waiting[MOST_AT_ONCE:]
                await self._commit(batch)

    async def _commit(self, batch: list[tuple[list[Statement], asyncio.Future[None]]]) -> None:
        error = await self._refusal([row for rows, _ in batch for row in rows])
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

    async def _refusal(self, rows: list[Statement]) -> Exception | None:
        try:
            await self._commit_all(_runs(rows))
        except Exception as error:  # noqa: BLE001 - a row that cannot be stored must not end the writer
            return error
        return None


class InThread:
    """SQLite: its own connection in its own thread. The event loop pays one hop a transaction, not one a call."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="store-writer")

    async def commit(self, statements: list[Statement]) -> None:
        """Execute in one transaction."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._execute, statements)

    def _execute(self, statements: list[Statement]) -> None:
        with self._engine.begin() as connection:
            for statement, params in statements:
                connection.execute(statement, params or None)

    async def close(self) -> None:
        """Let go of the connection."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._engine.dispose)
        self._thread.shutdown()


class OnLoop:
    """PostgreSQL: the driver waits on the event loop by itself."""

    def __init__(self, engine: AsyncEngine) -> None:
        self._engine = engine

    async def commit(self, statements: list[Statement]) -> None:
        """Execute in one transaction."""
        async with self._engine.begin() as connection:
            for statement, params in statements:
                await connection.execute(statement, params or None)

    async def close(self) -> None:
        """Nothing to let go of: the engine is the database's."""


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
