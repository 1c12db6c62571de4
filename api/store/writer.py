"""The only writer of the service: one commit for everything that arrived during the last one.

Flying comes first: what a flight stores (`keep=True`) is never refused because the database does not answer. It is held
in order and tried again until it is stored, and meanwhile a local file holds it too (`spill`), so that a restart can
continue. So it does while a commit hangs: a flight goes on once the database has what it stored, or the file. Writes of
clients are refused at once in that state: nothing is half done.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import structlog
from sqlalchemy import Executable
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, ProgrammingError

from skyfolio.api.common.surroundings import monotonic_s
from skyfolio.api.store.errors import StoreError

log = structlog.get_logger()
Params: TypeAlias = dict[str, Any] | list[dict[str, Any]]
Statement: TypeAlias = tuple[Executable, Params]
Commit: TypeAlias = Callable[[list[Statement]], Awaitable[None]]
"""Executes statements in one transaction; raises whatever the database reports."""
MOST_AT_ONCE = 500
MOST_HELD = 50_000
"""Transactions of flights that are held while the database does not answer, some 50 MB; those beyond are refused."""
STUCK_AFTER_S = 1.0
"""Seconds after which a commit that is not done counts as a database that does not answer."""
AGAIN_S = (0.1, 0.3, 1.0)
"""Pauses before the next tries; the last one repeats."""


class Holds(Protocol):
    """Keeps statements that the database does not accept, so that they outlive the process (`spill.Spill`)."""

    async def add(self, transactions: list[list[Statement]]) -> None:
        """Keep these transactions as well."""

    async def clear(self) -> None:
        """Forget all that is kept: the database has it."""


@dataclass(eq=False)
class _Transaction:
    """The statements of one call. `keep`: they belong to a flight."""

    statements: list[Statement]
    done: asyncio.Future[None]
    keep: bool


class Writer:
    """Writes in the order of the calls. Created on the event loop that it is used on."""

    def __init__(self, commit: Commit, holds: Holds | None = None) -> None:
        self._commit_all, self._holds = commit, holds
        self._waiting: list[_Transaction] = []
        self._batch: list[_Transaction] = []
        """What is being committed."""
        self._news = asyncio.Event()
        self._ending = False
        self._trouble: str | None = None
        self._is_stuck = False
        self._file_lock = asyncio.Lock()
        self._file_has_lines = False
        self._in_file: set[asyncio.Future[None]] = set()
        """Writes of flights that the local file has, and the database has not."""
        self._holding: asyncio.Task[None] | None = None
        self._next_hold: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(self._write_all(), name="store-writer")

    @property
    def trouble(self) -> str | None:
        """Return why nothing can be stored at present, None while the database answers."""
        if self._trouble is not None:
            return self._trouble
        return f"no answer for more than {STUCK_AFTER_S:g} s" if self._is_stuck else None

    @property
    def held(self) -> int:
        """Return how many transactions of flights wait to be stored."""
        return sum(transaction.keep for transaction in (*self._batch, *self._waiting))

    def write_soon(self, *statements: Executable | Statement, keep: bool = False) -> asyncio.Future[None]:
        """Queue one transaction; the future ends when it is durable, or with StoreError when it is refused.

        keep: it belongs to a flight, and is held while the database does not answer; any other is refused at
        once then.
        """
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        rows = [statement if isinstance(statement, tuple) else (statement, {}) for statement in statements]
        refusal = self._refusal(keep=keep)
        if refusal is not None:
            _refuse(done, refusal)
            return done
        self._waiting.append(_Transaction(rows, done, keep))
        self._news.set()
        if keep and self._is_holding:
            self._hold_soon()
        return done

    async def kept(self, done: asyncio.Future[None]) -> None:
        """Wait until a write of a flight is durable or refused, or the local file has it."""
        while not done.done() and done not in self._in_file:
            await asyncio.wait({done, self._next_hold}, return_when=asyncio.FIRST_COMPLETED)

    async def close(self) -> None:
        """Finish the writes that wait; what the database still refuses stays in the local file for the next start."""
        self._ending = True
        self._news.set()
        await self._task
        if self._holding is not None:
            await self._holding

    def _refusal(self, *, keep: bool) -> str | None:
        if self._trouble is None or not self._waiting:
            return None
        if not keep:
            return f"the database does not answer: {self._trouble}"
        return f"more than {MOST_HELD} transactions wait: {self._trouble}" if self.held >= MOST_HELD else None

    async def _write_all(self) -> None:
        tries = 0
        while self._waiting or not self._ending:
            await self._news.wait()
            self._news.clear()
            while self._waiting:
                self._batch, self._waiting = self._waiting[:MOST_AT_ONCE], self._waiting[MOST_AT_ONCE:]
                if self._in_file:  # what is newer than a line of the file must follow it there
                    await self._hold()
                kept = await self._commit(self._batch)
                self._batch, self._waiting = [], [*kept, *self._waiting]
                if not kept:
                    tries = 0
                    await self._recovered()
                    continue
                await self._hold()
                if self._ending:
                    log.critical("not stored", transactions=self.held, reason=self._trouble)
                    return
                await self._pause(AGAIN_S[min(tries, len(AGAIN_S) - 1)])
                tries += 1

    async def _commit(self, batch: list[_Transaction]) -> list[_Transaction]:
        """Store a batch; return those of flights that must be tried again, because the database does not answer."""
        error = await self._error_of([row for transaction in batch for row in transaction.statements])
        if error is not None and is_passing(error):
            if self._trouble is None:
                log.critical("the database does not answer", reason=str(error))
            self._trouble = _first_line(error)
            for transaction in batch:
                if not transaction.keep:
                    self._end(transaction, f"write: {error}")
            return [transaction for transaction in batch if transaction.keep]
        if error is not None and len(batch) > 1:  # find the bad one; the other writes are good
            return [unstored for transaction in batch for unstored in await self._commit([transaction])]
        for transaction in batch:
            if error is not None:
                log.error("write refused", error=str(error))
            self._end(transaction, None if error is None else f"write: {error}")
        return []

    def _end(self, transaction: _Transaction, refusal: str | None) -> None:
        self._in_file.discard(transaction.done)
        if refusal is not None:
            _refuse(transaction.done, refusal)
        elif not transaction.done.cancelled():
            transaction.done.set_result(None)

    async def _error_of(self, rows: list[Statement]) -> Exception | None:
        stuck = asyncio.get_running_loop().call_later(STUCK_AFTER_S, self._stuck)
        try:
            await self._commit_all(_runs(rows))
        except Exception as error:  # noqa: BLE001 - a row that cannot be stored must not end the writer
            return error
        finally:
            stuck.cancel()
            self._is_stuck = False
        return None

    def _stuck(self) -> None:
        self._is_stuck = True
        log.critical("the database does not answer", reason=self.trouble)
        self._hold_soon()

    async def _recovered(self) -> None:
        if self._trouble is not None:
            self._trouble = None
            log.warning("the database answers again", waiting=len(self._waiting))
        if not self._file_has_lines and not self._file_lock.locked():
            return
        async with self._file_lock:
            if self._file_has_lines and not self._in_file:
                self._file_has_lines = False
                if self._holds is not None:
                    await self._holds.clear()

    # -- the local file -------------------------------------------------------------------------------------------

    @property
    def _is_holding(self) -> bool:
        """Return whether what flights store goes into the local file as well."""
        return self.trouble is not None or bool(self._in_file)

    def _hold_soon(self) -> None:
        if self._holding is None or self._holding.done():
            self._holding = asyncio.create_task(self._hold(), name="store-holder")

    async def _hold(self) -> None:
        """Write what is not stored, and not in the local file yet, into it, in order."""
        async with self._file_lock:
            while new := self._not_held():
                self._file_has_lines = True
                if self._holds is not None:
                    await self._holds.add([transaction.statements for transaction in new])
                self._in_file.update(one.done for one in new if not one.done.done())
                held, self._next_hold = self._next_hold, asyncio.get_running_loop().create_future()
                held.set_result(None)

    def _not_held(self) -> list[_Transaction]:
        if not self._is_holding:
            return []
        unstored = (one for one in (*self._batch, *self._waiting) if one.keep and not one.done.done())
        return [one for one in unstored if one.done not in self._in_file]

    async def _pause(self, seconds: float) -> None:
        """Wait before the next try; the end of the service ends the wait."""
        until = monotonic_s() + seconds
        while not self._ending and (left_s := until - monotonic_s()) > 0:
            self._news.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    await self._news.wait()


def is_passing(error: Exception) -> bool:
    """Return whether the database did not answer (locked, full, gone), rather than refuse the statement."""
    if isinstance(error, IntegrityError | ProgrammingError | DataError):
        return False
    if isinstance(error, DBAPIError):
        return not any(words in str(error.orig) for words in ("no such", "syntax error", "has no column"))
    return isinstance(error, OSError)


def _refuse(done: asyncio.Future[None], reason: str) -> None:
    if not done.done():
        done.set_exception(StoreError(reason))
        done.exception()  # retrieved: without an awaiter it is only in the log


def _first_line(error: Exception) -> str:
    cause = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    return str(cause).splitlines()[0][:200] if str(cause) else type(cause).__name__


def _runs(rows: list[Statement]) -> list[Statement]:
    """Merge neighbours with the very same statement into one call with many parameter sets."""
    merged: list[tuple[Executable, Any]] = []
    for statement, params in rows:
        parameter_sets = params if isinstance(params, list) else [params]
        if merged and merged[-1][0] is statement and params:
            merged[-1][1].extend(parameter_sets)
        else:
            merged.append((statement, list(parameter_sets) if params else {}))
    return merged
