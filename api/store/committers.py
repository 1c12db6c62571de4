"""What executes the statements of the writer in one transaction: in a thread of its own, or on the event loop."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from sqlalchemy import Engine
from sqlalchemy.ext.asyncio import AsyncEngine

from skyfolio.api.store.writer import Statement


class ThreadCommitter:
    """SQLite: commits on its own connection in its own thread. The event loop pays one hop per transaction."""

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
        """Close the connection."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._engine.dispose)
        self._thread.shutdown()


class LoopCommitter:
    """PostgreSQL: commits on the event loop, as its driver is asynchronous."""

    def __init__(self, engine: AsyncEngine) -> None:
        self._engine = engine

    async def commit(self, statements: list[Statement]) -> None:
        """Execute in one transaction."""
        async with self._engine.begin() as connection:
            for statement, params in statements:
                await connection.execute(statement, params or None)

    async def close(self) -> None:
        """Do nothing: the engine belongs to the database."""
