"""Base stations of a simulated fleet that reach their service over REST: what `skyfolio simulate --radio URL` adds."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import httpx2
import structlog

from skyfolio import sim
from skyfolio.api.client import ApiError, Client
from skyfolio.api.flights.allocations import AllocationsView
from skyfolio.api.flights.base_stations import ASK_EVERY_S, BaseStations, assumed_by, radio_truth
from skyfolio.api.flights.measured_rates import Measurement
from skyfolio.api.flights.operation_views import ENDED, OperationView
from skyfolio.planner import Plan

log = structlog.get_logger()
CONFLICT = 409
LOOK_EVERY_S = 1.0
"""Wall seconds between two looks for an operation."""


class RestPort:
    """Reaches a service over HTTP, in threads: a slow answer stops no vehicle."""

    def __init__(self, client: Client, operation_id: str) -> None:
        self._client, self._id = client, operation_id

    async def allocations(self) -> AllocationsView | None:
        """Return what base stations must serve; None once the operation has ended."""
        try:
            return await asyncio.to_thread(self._client.allocations, self._id)
        except ApiError as error:
            if error.status == CONFLICT:
                return None
            raise

    async def acknowledge(self, uav_id: str, revision: int) -> bool:
        """Acknowledge a revision; return whether that was accepted: it may be stale by now."""
        try:
            await asyncio.to_thread(self._client.acknowledge, self._id, uav_id, revision)
        except ApiError as error:
            if error.status == CONFLICT:
                return False
            raise
        return True

    async def measure(self, measurements: Sequence[Measurement]) -> None:
        """Report what users get."""
        await asyncio.to_thread(self._client.measure, self._id, measurements)


class RadioClient:
    """Serves one operation of a service after the other, until it is cancelled.

    channel: the true one, without reference and noise, which are those of the operation's scenario.
    """

    def __init__(self, fleet: sim.Fleet, client: Client, channel: sim.TruthChannel, speedup: float) -> None:
        self._fleet, self._client, self._channel, self._speedup = fleet, client, channel, speedup

    async def run(self) -> None:
        """Look for operations, and serve each to its end; a service that does not answer is asked again."""
        while True:
            try:
                operation = await asyncio.to_thread(self._active)
                if operation is not None:
                    await self._serve(operation)
            except (ApiError, httpx2.HTTPError) as error:
                log.warning("base stations do not reach the service", reason=str(error))
            await asyncio.sleep(LOOK_EVERY_S)

    def _active(self) -> OperationView | None:
        """Return the newest operation that has not ended and flies vehicles of this fleet."""
        for row in self._client.operations():
            if row.state not in ENDED:
                found = self._client.operation(row.id)
                if set(found.vehicles.values()) <= set(self._fleet.vehicles):
                    return found
        return None

    async def _serve(self, operation: OperationView) -> None:
        plan = await asyncio.to_thread(self._client.read_plan, operation.plan_ids[0])
        if not isinstance(plan, Plan):
            return
        truth = radio_truth(self._fleet, plan.scenario, assumed_by(plan.scenario, self._channel), operation.vehicles)
        stations = BaseStations(self._fleet, truth, RestPort(self._client, operation.id), operation.vehicles)
        while await stations.step():  # noqa: ASYNC110 - it asks another process
            await asyncio.sleep(ASK_EVERY_S / self._speedup)
