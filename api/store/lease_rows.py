"""How a service reads and changes the leases: what every kind of database has in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable
from hashlib import sha256

from sqlalchemy import delete, insert, text

from skyfolio.api.store.lease_book import Lease
from skyfolio.api.store.tables import leased_vehicles, leases
from skyfolio.api.store.writer import Statement

FIRST_TOKEN = 1
REQUIRE_LEASE = "SELECT require_lease(:operation_id, :token)"
"""Raises an IntegrityError, which refuses the whole transaction, unless the lease has this token."""
_REQUIRE = text(REQUIRE_LEASE)
_INSERT, _INSERT_VEHICLE = insert(leases), insert(leased_vehicles)


def sessions_of(name: str) -> str:
    """Return how the database sessions of a service are marked."""
    return f"skyfolio-{sha256(name.encode()).hexdigest()[:16]}"


class LeaseRows(ABC):
    """The leases as one service sees them. me: its id, of this process alone; name: what its operators call it."""

    def __init__(self, *, me: str, name: str) -> None:
        self.me, self.name = me, name
        self.clock_ahead_s = 0.0
        """By how much this machine's UTC clock is at least ahead of the database's, by the last look; 0 if unknown."""

    @abstractmethod
    async def adopt(self) -> None:
        """Make free leases of operations without one: they began before there were several services."""

    @abstractmethod
    async def look(self, held: Collection[str]) -> list[Lease]:
        """Renew what this service holds and return every lease. Raises StoreError."""

    @abstractmethod
    async def take(self, lease: Lease) -> int | None:
        """Take a lease that is still as it was seen; return its new token, None if it is not. Raises StoreError."""

    @abstractmethod
    async def leave(self) -> None:
        """Give up every lease of this service, so that others need not wait. Raises StoreError."""

    def made(self, operation_id: str, systems: Iterable[int]) -> list[Statement]:
        """Return what stores the lease of a new operation; refused if another operation has one of its vehicles."""
        lease = {"operation_id": operation_id, "owner": self.me, "name": self.name, "token": FIRST_TOKEN, "beat": 0}
        vehicles = [{"system_id": system_id, "operation_id": operation_id} for system_id in systems]
        return [(_INSERT, lease), (_INSERT_VEHICLE, vehicles)]

    def ended(self, operation_id: str) -> Statement:
        """Return what deletes the lease of an operation that is over."""
        return delete(leases).where(leases.c.operation_id == operation_id), {}

    def required(self, operation_id: str, token: int) -> Statement:
        """Return what refuses a transaction whose service no longer has the lease under that token."""
        return _REQUIRE, {"operation_id": operation_id, "token": token}
