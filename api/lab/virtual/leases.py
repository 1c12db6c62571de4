"""The leases on a disk in memory, for services that share it."""

from __future__ import annotations

from collections.abc import Collection

from sqlalchemy import Connection, select, text, update

from skyfolio.api.lab.virtual.disk import MemoryBackend
from skyfolio.api.store.lease_book import NOBODY, Lease
from skyfolio.api.store.lease_rows import LeaseRows
from skyfolio.api.store.tables import leased_vehicles, leases, operations
from skyfolio.api.store.writer import Statement

_REQUIRE = text(
    "INSERT INTO leases (operation_id, owner, name, token, beat) SELECT :operation_id, NULL, '', 0, 0 "
    "WHERE NOT EXISTS (SELECT 1 FROM leases WHERE operation_id = :operation_id AND token = :token)"
)
"""Breaks a constraint, which refuses the whole transaction, unless the lease has this token."""


class MemoryLeaseTable(LeaseRows):
    """The leases as one service sees them through its line to the disk."""

    def __init__(self, backend: MemoryBackend, *, me: str, name: str) -> None:
        super().__init__(me=me, name=name)
        self._backend = backend

    async def adopt(self) -> None:
        """Do nothing: services on one disk have shared it from the beginning."""

    async def look(self, held: Collection[str]) -> list[Lease]:
        """Renew what this service holds and return every lease."""
        return await self._backend.in_transaction(lambda connection: self._looked(connection, held))

    async def take(self, lease: Lease) -> int | None:
        """Take a lease that is still as it was seen; return its new token, None if it is not."""
        as_seen = [leases.c[name] == getattr(lease, name) for name in ("operation_id", "owner", "token", "beat")]
        changes = {"owner": self.me, "name": self.name, "token": leases.c.token + 1, "beat": 0}
        taken = update(leases).where(*as_seen).values(changes)
        done = await self._backend.in_transaction(lambda connection: connection.execute(taken).rowcount)
        return lease.token + 1 if done else None

    async def leave(self) -> None:
        """Give up every lease of this service."""
        left = update(leases).where(leases.c.owner == self.me)
        left = left.values(owner=NOBODY, name=NOBODY, beat=leases.c.beat + 1)
        await self._backend.in_transaction(lambda connection: connection.execute(left))

    def required(self, operation_id: str, token: int) -> Statement:
        """Return what refuses a transaction whose service no longer has the lease under that token."""
        return _REQUIRE, {"operation_id": operation_id, "token": token}

    def _looked(self, connection: Connection, held: Collection[str]) -> list[Lease]:
        ours = (leases.c.owner == self.me) & leases.c.operation_id.in_(held)
        renewed = set(connection.execute(select(leases.c.operation_id).where(ours)).scalars())
        connection.execute(update(leases).where(ours).values(beat=leases.c.beat + 1))
        query = select(leases, operations.c.version).join(operations, operations.c.id == leases.c.operation_id)
        systems: dict[str, set[int]] = {}
        for row in connection.execute(select(leased_vehicles)).all():
            systems.setdefault(row.operation_id, set()).add(row.system_id)
        return [
            Lease(
                **row, systems=frozenset(systems.get(row["operation_id"], ())), renewed=row["operation_id"] in renewed
            )
            for row in connection.execute(query).mappings()
        ]
