"""How the base stations of a fleet in virtual time reach whatever service lives on their ground."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, TypeVar

from skyfolio.api.flights.allocations import AllocationsView
from skyfolio.api.flights.base_stations import OperationPort
from skyfolio.api.flights.measured_rates import Measurement
from skyfolio.api.lab.virtual.ground import Ground

Result = TypeVar("Result")


class GroundPort:
    """Reaches an operation of the service that lives, as its clients do; a dead service is silent."""

    def __init__(self, ground: Ground, operation_id: str) -> None:
        self._ground, self._id = ground, operation_id

    async def allocations(self) -> AllocationsView | None:
        """Return what base stations must serve; None once the operation has ended, or while no service lives."""
        return await self._ask(lambda port: port.allocations(), None)

    async def acknowledge(self, uav_id: str, revision: int) -> bool:
        """Acknowledge a revision; return whether that was accepted."""
        return await self._ask(lambda port: port.acknowledge(uav_id, revision), False)

    async def measure(self, measurements: Sequence[Measurement]) -> None:
        """Report what users get."""
        await self._ask(lambda port: port.measure(measurements), None)

    async def _ask(self, work: Callable[[OperationPort], Coroutine[Any, Any, Result]], silence: Result) -> Result:
        service = self._ground.service
        if service is None:
            return silence
        try:
            return await self._ground.ask(work(OperationPort(service.operations, self._id)))
        except asyncio.CancelledError:
            if self._ground.service is service:
                raise
            return silence  # it was killed meanwhile
