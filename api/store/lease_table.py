"""The leases in PostgreSQL, on connections of their own: a renewal never waits for what else is read or stored.

A connection that does not answer is dropped at once and made anew: nothing is asked of it any more.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from contextlib import suppress
from typing import Any

from sqlalchemy.engine import URL, make_url
from sqlalchemy.ext.asyncio import create_async_engine

from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.store.errors import StoreError
from skyfolio.api.store.lease_book import NOBODY, Lease
from skyfolio.api.store.lease_rows import LeaseRows, sessions_of

_LOOK = """
WITH renewed AS (
  UPDATE leases SET beat = beat + 1 WHERE owner = $1 AND operation_id = ANY($2::varchar[]) RETURNING operation_id
)
SELECT l.operation_id, l.owner, l.name, l.token, l.beat, o.version,
  ARRAY(SELECT v.system_id FROM leased_vehicles v WHERE v.operation_id = l.operation_id) AS systems,
  l.operation_id IN (SELECT operation_id FROM renewed) AS renewed,
  extract(epoch FROM clock_timestamp())::float8 AS utc_s
FROM leases l JOIN operations o ON o.id = l.operation_id
"""
_TAKE = """
UPDATE leases SET owner = $1, name = $2, token = token + 1, beat = 0 WHERE operation_id IN (
  SELECT operation_id FROM leases WHERE operation_id = $3 AND owner = $4 AND token = $5 AND beat = $6
  FOR UPDATE SKIP LOCKED
) RETURNING token
"""
"""It does not wait for a transaction of the owner that is being committed: that one is whole, or refused."""
_END_TRANSACTIONS = """
SELECT pg_terminate_backend(pid) FROM pg_stat_activity
WHERE application_name = $1 AND datname = current_database() AND xact_start IS NOT NULL
"""
"""A service that was stopped in a transaction holds locks on which the writes of all others wait."""
_ADOPT = """
INSERT INTO leases (operation_id, owner, name, token, beat)
SELECT id, '', '', 0, 0 FROM operations WHERE ended_at IS NULL ON CONFLICT DO NOTHING
"""
_ADOPT_VEHICLES = """
INSERT INTO leased_vehicles (system_id, operation_id)
SELECT (vehicle.value)::integer, o.id
FROM operations o JOIN leases l ON l.operation_id = o.id, json_each_text(o.document::json -> 'vehicles') AS vehicle
WHERE o.ended_at IS NULL ON CONFLICT DO NOTHING
"""
_CLEAR = "DELETE FROM leases USING operations o WHERE o.id = operation_id AND o.ended_at IS NOT NULL"
_LEAVE = "UPDATE leases SET owner = '', name = '', beat = beat + 1 WHERE owner = $1"


class LeaseTable(LeaseRows):
    """The leases at this URL. timeout_s: after which a question that is not answered has failed."""

    def __init__(self, url: str, *, me: str, name: str, timeout_s: float) -> None:
        self._options = _options(make_url(url))
        super().__init__(me=me, name=name)
        self._timeout_s = timeout_s
        self._looking: Any = None

    async def adopt(self) -> None:
        """Make free leases of operations without one: they began before there were several services."""
        connection = await self._connect()
        try:
            for statement in (_CLEAR, _ADOPT, _ADOPT_VEHICLES):
                await connection.execute(statement, timeout=self._timeout_s)
        finally:
            connection.terminate()

    async def look(self, held: Collection[str]) -> list[Lease]:
        """Renew what this service holds and return every lease. Raises StoreError."""
        try:
            async with asyncio.timeout(self._timeout_s):
                self._looking = self._looking or await self._connect()
                began_s = utc_s()
                rows = await self._looking.fetch(_LOOK, self.me, list(held))
                ended_s = utc_s()
        except BaseException as error:
            self._drop()
            if isinstance(error, Exception):
                raise StoreError(f"leases: {str(error) or type(error).__name__}") from error
            raise
        found = list(map(dict, rows))
        for row in found:
            there_s = row.pop("utc_s")
            self.clock_ahead_s = max(0.0, began_s - there_s) + min(0.0, ended_s - there_s)
        return [Lease(**{**row, "systems": frozenset(row["systems"])}) for row in found]

    async def take(self, lease: Lease) -> int | None:
        """Take a lease that is still as it was seen; return its new token, None if it is not. Raises StoreError."""
        connection = None
        try:
            async with asyncio.timeout(self._timeout_s):
                connection = await self._connect()
                token = await connection.fetchval(
                    _TAKE, self.me, self.name, lease.operation_id, lease.owner, lease.token, lease.beat
                )
                if token is not None and lease.name not in (NOBODY, self.name):
                    await connection.execute(_END_TRANSACTIONS, sessions_of(lease.name))
        except Exception as error:
            raise StoreError(f"leases: {str(error) or type(error).__name__}") from error
        finally:
            if connection is not None:
                connection.terminate()
        return None if token is None else int(token)

    async def leave(self) -> None:
        """Give up every lease of this service, so that others need not wait. Raises StoreError."""
        try:
            async with asyncio.timeout(self._timeout_s):
                self._looking = self._looking or await self._connect()
                await self._looking.execute(_LEAVE, self.me)
        except Exception as error:
            raise StoreError(f"leases: {str(error) or type(error).__name__}") from error
        finally:
            self._drop()

    async def _connect(self) -> Any:
        import asyncpg  # type: ignore[import-untyped]  # noqa: PLC0415 - an extra

        return await asyncpg.connect(**self._options, timeout=self._timeout_s, command_timeout=self._timeout_s)

    def _drop(self) -> None:
        looking, self._looking = self._looking, None
        if looking is not None:
            with suppress(OSError):
                looking.terminate()


def _options(url: URL) -> dict[str, Any]:
    """Return the arguments of `asyncpg.connect` that this URL stands for."""
    _, options = create_async_engine(url).dialect.create_connect_args(url)
    return {name: value for name, value in options.items() if not name.startswith("prepared_statement_")}
