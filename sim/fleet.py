"""The fleet: all vehicles, stepped together on one clock, each with a socket of its own."""

import asyncio
import random
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import Any, Self

from sim.clock import Clock
from sim.faults import Fault
from sim.lineup import VehicleSpec
from sim.link import endpoints_of, open_link
from sim.station import Vehicle
from sim.truth import SAMPLE_INTERVAL_S, Event, TruthLog
from sim.vehicle import Limits

DEFAULT_ENDPOINT = "udpout://127.0.0.1:14540"
STEP_S = 0.05
"""Fleet seconds in one step of the dynamics."""
WAKE_S = 0.01
"""Wall seconds between two looks at the clock."""
STRIDE_S = 1.0
"""Fleet seconds caught up at once, before the event loop gets its turn."""


class Fleet:
    """Simulated vehicles that talk MAVLink 2 over UDP while the context is open.

    `async with fleet:` opens the sockets and flies on `clock`. Without it nothing is sent, and `step_to` moves the
    whole fleet in virtual time. `seed` spreads the telemetry streams of the vehicles; `protocol_clock` gives wall
    seconds for the time-outs of the mission protocol. ValueError for no vehicles, duplicate ids or a bad endpoint.
    """

    def __init__(
        self,
        specs: Iterable[VehicleSpec],
        *,
        clock: Clock,
        endpoint: str = DEFAULT_ENDPOINT,
        limits: Limits | None = None,
        seed: int = 0,
        protocol_clock: Callable[[], float] = time.monotonic,
    ) -> None:
        lineup = list(specs)
        if not lineup:
            raise ValueError("a fleet needs at least one vehicle")
        ids = [spec.system_id for spec in lineup]
        if len(set(ids)) != len(ids):
            raise ValueError(f"system ids must differ, got {sorted(ids)}")
        self.clock = clock
        self.truth = TruthLog()
        self.now_s = self._start_s = clock.now()
        self._steps = 0
        self._endpoints = dict(zip(ids, endpoints_of(endpoint, len(lineup)), strict=True))
        self._scheduled: list[tuple[float, Fault]] = []
        self._flying: asyncio.Task[None] | None = None
        spread = random.Random(seed)  # noqa: S311
        self.vehicles: dict[int, Vehicle] = {
            spec.system_id: Vehicle(
                spec,
                limits=limits,
                protocol_clock=protocol_clock,
                on_event=partial(self._log, spec.system_id),
                boot_s=self.now_s,
                phase=spread.random(),
            )
            for spec in lineup
        }

    def inject(self, fault: Fault, *, at_s: float | None = None) -> None:
        """Let a fault happen now, or once fleet time reaches `at_s`. ValueError for an unknown vehicle."""
        if fault.system_id not in self.vehicles:
            raise ValueError(f"there is no vehicle {fault.system_id}; the fleet has {sorted(self.vehicles)}")
        if at_s is None:
            fault.strike(self.vehicles[fault.system_id])
        else:
            self._scheduled.append((at_s, fault))

    def step_to(self, t_s: float) -> None:
        """Fly in fixed steps as far as whole steps fit before fleet time `t_s`."""
        while (after := self._start_s + (self._steps + 1) * STEP_S) <= t_s + 1e-9:
            self._strike_due()
            self._steps += 1
            self.now_s = after
            for vehicle in self.vehicles.values():
                vehicle.step(after, STEP_S)
            if self._steps % round(SAMPLE_INTERVAL_S / STEP_S) == 0:
                for vehicle in self.vehicles.values():
                    self.truth.record(after, vehicle)

    async def wait(self) -> None:
        """Wait while the fleet flies; returns when its context is closed, raises what broke it."""
        if self._flying is not None:
            await asyncio.wait([self._flying])
            if not self._flying.cancelled():
                self._flying.result()

    async def __aenter__(self) -> Self:
        try:
            for system_id, vehicle in self.vehicles.items():
                if vehicle.transmitting:
                    vehicle.link = await open_link(*self._endpoints[system_id], vehicle.receive)
        except BaseException:
            self._close_links()
            raise
        self._flying = asyncio.create_task(self._fly(), name="sim-fleet")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        flying, self._flying = self._flying, None
        self._close_links()
        if flying is not None:
            flying.cancel()
            with suppress(asyncio.CancelledError):
                await flying

    async def _fly(self) -> None:
        while True:
            now_s = self.clock.now()
            self.step_to(min(now_s, self.now_s + STRIDE_S))
            await asyncio.sleep(0.0 if now_s - self.now_s > STRIDE_S else WAKE_S)

    def _strike_due(self) -> None:
        due = [entry for entry in self._scheduled if entry[0] <= self.now_s + 1e-9]
        for entry in due:
            self._scheduled.remove(entry)
            entry[1].strike(self.vehicles[entry[1].system_id])

    def _close_links(self) -> None:
        for vehicle in self.vehicles.values():
            if vehicle.link is not None:
                vehicle.link.close()
                vehicle.link = None

    def _log(self, system_id: int, kind: str, detail: dict[str, Any]) -> None:
        self.truth.events.append(Event(self.now_s, system_id, kind, detail))


async def serve(fleet: Fleet, *, until: asyncio.Event | None = None, for_s: float | None = None) -> None:
    """Fly a fleet until `until` is set, `for_s` fleet seconds have passed, or the caller is cancelled.

    With neither it flies on until cancelled. Whatever breaks the fleet is raised here.
    """
    async with fleet:
        ends: list[asyncio.Task[Any]] = [asyncio.create_task(fleet.wait())]
        if until is not None:
            ends.append(asyncio.create_task(until.wait()))
        if for_s is not None:
            ends.append(asyncio.create_task(_reach(fleet, fleet.now_s + for_s)))
        try:
            done, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            for end in done:
                end.result()
        finally:
            for end in ends:
                end.cancel()


async def _reach(fleet: Fleet, t_s: float) -> None:
    while fleet.now_s < t_s:  # noqa: ASYNC110
        await asyncio.sleep(WAKE_S)
