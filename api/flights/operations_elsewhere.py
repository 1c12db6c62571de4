"""The operations of other services that share the database: their air is kept clear of as that of our own."""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from typing import Any

from sqlalchemy import Row, select

from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.airspace import SharedAirspace
from skyfolio.api.flights.operation_store import Stores
from skyfolio.api.flights.operation_views import ENDED, State
from skyfolio.api.flights.restart import restored
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.store import StoreError
from skyfolio.api.store.tables import operations as table

LOOK_EVERY_S = 1.0
"""Wall seconds between looks at what other services fly."""


class OperationsElsewhere:
    """Enters the flights of other services into the shared airspace, as they were last stored, and takes them out."""

    def __init__(self, shared: SharedServices, stores: Stores, fleet: Fleet, airspace: SharedAirspace) -> None:
        self._shared, self._stores, self._fleet, self._airspace = shared, stores, fleet, airspace
        self._entered: dict[str, int] = {}
        """The version in which each one was entered."""
        self._looking = asyncio.Lock()

    async def follow(self) -> None:
        """Look again and again."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            with suppress(StoreError):  # readiness reports a database that does not answer
                await self.look()

    async def look(self) -> None:
        """Bring the airspace up to date. Raises StoreError."""
        leases = self._stores.database.leases
        if leases is None:
            return
        async with self._looking:
            versions = {
                operation_id: lease.version
                for operation_id, lease in leases.book.rows.items()
                if leases.book.owner_of(operation_id) is not None
            }
            for operation_id in [one for one in self._entered if one not in versions]:
                del self._entered[operation_id]
                if operation_id not in leases.book.held:  # else it is ours now, and has been entered as such
                    self._airspace.leave(operation_id)
            for operation_id, version in versions.items():
                if self._entered.get(operation_id) != version:
                    await self._enter(operation_id, version)

    async def _enter(self, operation_id: str, version: int) -> None:
        rows = await self._stores.database.rows(select(table).where(table.c.id == operation_id))
        leases = self._stores.database.leases
        if not rows or State(rows[0].state) in ENDED or not self._are_registered(rows[0]):
            return
        operation = await restored(rows[0], self._shared, self._stores, self._fleet, with_track=False)
        if leases is not None and operation_id not in leases.book.held:
            self._airspace.enter(operation_id, operation.flight)
            self._entered[operation_id] = version

    def _are_registered(self, row: Row[Any]) -> bool:
        """Return whether this service knows the vehicles yet: those of another are read from the registry."""
        return set(json.loads(row.document)["vehicles"]) <= set(self._fleet.uav_ids)
