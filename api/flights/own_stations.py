"""The base stations of the service's own simulated fleet: they serve, and report to, each operation that it flies."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from typing import Any, TypeVar

from skyfolio import sim
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.fleet.simulated_fleet import SimulatedFleet
from skyfolio.api.flights.allocations import AllocationsView
from skyfolio.api.flights.base_stations import ASK_EVERY_S, BaseStations, OperationPort, assumed_by, radio_truth
from skyfolio.api.flights.measured_rates import Measurement
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operations import Operations

Result = TypeVar("Result")


class OwnStations:
    """Joins base stations to operations, from the first of them to the last. channel: what users truly get.

    The fleet lives in a thread of its own, and so do its base stations: they reach the operation from there.
    """

    def __init__(
        self, simulated: SimulatedFleet, fleet: Fleet, operations: Operations, channel: sim.TruthChannel
    ) -> None:
        self._simulated, self._fleet, self._operations = simulated, fleet, operations
        self._channel, self._every_s = channel, ASK_EVERY_S / simulated.speedup
        self._joined: dict[str, BaseStations] = {}

    async def run(self) -> None:
        """Let base stations ask, acknowledge and report, until cancelled."""
        while True:
            await asyncio.sleep(self._every_s)
            flying = {one.id: one for one in self._operations.in_the_air if self._carries(one)}
            self._joined = {one.id: self._joined.get(one.id) or self._stations_of(one) for one in flying.values()}
            for stations in self._joined.values():
                await self._simulated.meanwhile(stations.step())

    def _carries(self, operation: Operation) -> bool:
        """Return whether the vehicles of an operation are those that the service simulates."""
        return all(map(self._fleet.is_simulated, operation.flight.systems))

    def _stations_of(self, operation: Operation) -> BaseStations:
        fleet, flight = self._simulated.fleet, operation.flight
        scenario = flight.first_plan.scenario
        if flight.pool is not None:
            scenario = scenario.with_changes(uavs=tuple(flight.pool.uavs.values()))
        truth = radio_truth(fleet, scenario, assumed_by(scenario, self._channel), flight.systems)
        port = _FromTheFleet(OperationPort(self._operations, operation.id), asyncio.get_running_loop())
        return BaseStations(fleet, truth, port, flight.systems)


class _FromTheFleet:
    """Reaches an operation from the thread of the fleet."""

    def __init__(self, port: OperationPort, loop: asyncio.AbstractEventLoop) -> None:
        self._port, self._loop = port, loop

    async def allocations(self) -> AllocationsView | None:
        """Return what base stations must serve; None once the operation has ended."""
        return await self._there(self._port.allocations())

    async def acknowledge(self, uav_id: str, revision: int) -> bool:
        """Acknowledge a revision; return whether that was accepted."""
        return await self._there(self._port.acknowledge(uav_id, revision))

    async def measure(self, measurements: Sequence[Measurement]) -> None:
        """Report what users get."""
        await self._there(self._port.measure(measurements))

    async def _there(self, work: Coroutine[Any, Any, Result]) -> Result:
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(work, self._loop))
