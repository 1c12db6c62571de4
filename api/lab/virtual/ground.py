"""The ground: one fleet, and the service that flies it, which may be killed and started again.

    async with Ground(scenario, seed=7) as ground:
        service = await ground.start()
        ...
        ground.kill()               # as SIGKILL does: nothing is finished, the fleet flies on
        service = await ground.start()

Runs on a `VirtualLoop`, whose seconds are the fleet's. What belongs to a service (its tasks, its open database, its end
of the link) dies with it; the disk, the fleet and the air do not.
"""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable, Coroutine, Iterable
from contextlib import suppress
from contextvars import copy_context
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from itertools import count
from types import TracebackType
from typing import Any, Self, TypeVar

from sqlalchemy import select

from skyfolio import sim
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.surroundings import Surroundings, new_token, surrounded
from skyfolio.api.fleet.fleet_ports import FleetPorts
from skyfolio.api.fleet.simulated_fleet import hills_of, specs_at_starts, weather_of
from skyfolio.api.lab.virtual.disk import Disk, Line, MemoryBackend
from skyfolio.api.lab.virtual.guards import carry_out
from skyfolio.api.lab.virtual.leases import MemoryLeaseTable
from skyfolio.api.lab.virtual.loop import Life, life_here
from skyfolio.api.lab.virtual.running import Running
from skyfolio.api.lab.virtual.solving import Workers
from skyfolio.api.lab.virtual.wire import MemoryMessages, Port
from skyfolio.api.plans.jobs import Job
from skyfolio.api.service import Ports, Service
from skyfolio.api.store import Database
from skyfolio.api.store.event_log import Event
from skyfolio.api.store.leases import Leases
from skyfolio.api.store.spill import Spill
from skyfolio.api.store.tables import events as events_table
from skyfolio.mavlink_bridge.autopilots import DEFAULT_AUTOPILOT
from skyfolio.mavlink_bridge.ports import LinkPorts
from skyfolio.planner import Scenario
from skyfolio.sim.fleet import STEP_S

Result = TypeVar("Result")
EPOCH_S = 1_790_000_000.0
"""UTC second at which virtual time begins."""
BURIAL_TURNS = 200
SOLVE_S = 0.05
"""Virtual seconds of a small solve on a warm worker."""


def small_solve_s(job: Job) -> float:
    """Return the virtual seconds that a job takes unless a drill says otherwise."""
    del job
    return SOLVE_S


class Ground:
    """A fleet at the starts of a scenario, with a disk and workers for its service.

    seed: decides every id, phase and gust. specs: the vehicles; by default PX4 at the starts. weather: by default the
    scenario's; it may have fronts. crew: who changes batteries, of which packs; by default there is no crew. several:
    several services may live at once, which share the disk and the fleet by leases. settings: beside those that virtual
    time needs.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int = 0,
        specs: Iterable[sim.VehicleSpec] | None = None,
        weather: sim.Weather | None = None,
        crew: sim.GroundCrew | None = None,
        solve_s: Callable[[Job], float] = small_solve_s,
        several: bool = False,
        **settings: Any,
    ) -> None:
        self.scenario = scenario
        self._loop = asyncio.get_running_loop()
        self.fleet = sim.Fleet(
            specs_at_starts(scenario) if specs is None else specs,
            clock=_LoopClock(),
            seed=seed,
            weather=weather or weather_of(scenario),
            hills=hills_of(scenario),
            crew=crew,
        )
        self.disk, self.workers = Disk(), Workers(solve_s)
        self.on_event: Callable[[Event], None] = lambda _event: None
        """Called with each event of a service that has started, as it is stored."""
        self.after_step: Callable[[], None] = lambda: None
        """Called after each step of the fleet."""
        self.service: Service | None = None
        """The service that was started last, while it lives."""
        self.clock_ahead_s = 0.0
        """How far the service's UTC clock is ahead."""
        self.starts = 0
        """How often a service was started."""
        self._settings = Settings(database_url="in-memory", telemetry_hz=1.0, **settings)
        self._chance = random.Random(f"ground/{seed}")  # noqa: S311
        self._several = several
        self._ports: list[Port] = []
        self._running: list[Running] = []
        self._burials: list[asyncio.Task[None]] = []
        self._guarding: list[asyncio.Task[None]] = []
        self._flying: asyncio.Task[None] | None = None
        self._context = copy_context()
        self._around = surrounded(
            Surroundings(
                monotonic_s=self._loop.time, utc_s=self._utc_s, token=lambda size: self._chance.randbytes(size).hex()
            )
        )

    async def __aenter__(self) -> Self:
        self._around.__enter__()
        self._context = copy_context()
        self._flying = self.spawn(self._fly(), name="fleet")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            for running in [one for one in self._running if one.service is not None]:
                await self.stop(running.service)
            await asyncio.gather(*self._burials, *self._guarding)
        finally:
            if self._flying is not None:
                self._flying.cancel()
                with suppress(asyncio.CancelledError):
                    await self._flying
            self.disk.close()
            self._around.__exit__(kind, error, trace)

    @staticmethod
    def specs_of(
        scenario: Scenario, autopilots: Iterable[str] = (), battery_mah: float = sim.BATTERY_MAH
    ) -> list[sim.VehicleSpec]:
        """Return a vehicle at each UAV's start with one of the autopilots in turn; without any, the default one.

        battery_mah: what a new battery holds; `sim.capacity_for_mah` has it for minutes of hovering.
        """
        chosen = [*autopilots] or [DEFAULT_AUTOPILOT.value]
        specs = specs_at_starts(scenario, battery_mah=battery_mah)
        return [replace(spec, autopilot=chosen[place % len(chosen)]) for place, spec in enumerate(specs)]

    @property
    def now_s(self) -> float:
        """Return the virtual second."""
        return self._loop.time()

    @property
    def alive_tasks(self) -> list[str]:
        """Return the names of the tasks of all services that have not ended."""
        return [task.get_name() for running in self._running for task in running.life.tasks.values()]

    def heard_s(self, system_id: int) -> float:
        """Return the virtual second in which something of a vehicle arrived last; 0 if nothing has."""
        return max((port.heard_s.get(system_id, 0.0) for port in self._ports), default=0.0)

    def heartbeats_s(self, system_id: int) -> list[float]:
        """Return the virtual seconds in which HEARTBEATs of a vehicle arrived at a service, or a guard, that lived."""
        return [at_s for port in self._ports for at_s in port.heartbeats_s.get(system_id, ())]

    def stored_events(self) -> list[Event]:
        """Return every event on the disk, in order."""
        with self.disk.engine.connect() as connection:
            rows = connection.execute(select(events_table).order_by(events_table.c.id)).all()
        return [
            Event(id=row.id, at=datetime.fromtimestamp(row.at, UTC), kind=row.kind, data=json.loads(row.data))
            for row in rows
        ]

    # -- the service ----------------------------------------------------------------------------------------------

    async def start(self) -> Service:
        """Start a service on the disk, as it is. Raises RuntimeError while another one lives that does not share it."""
        if self.service is not None and not self._several:
            raise RuntimeError("a service lives already")
        life = Life()
        context = self._context.copy()
        context.run(life_here.set, life)
        running = Running(life=life, context=context, port=self._port_of_nobody())
        self._running.append(running)
        self.starts += 1
        self.service = running.service = service = await running.begin(self._open(running))
        service.events.listeners.append(lambda event: None if life.over else self.on_event(event))
        return service

    def spawn(self, work: Coroutine[Any, Any, Result], name: str | None = None) -> asyncio.Task[Result]:
        """Begin a task of the ground, which outlives every service, from wherever this is called."""
        return self._loop.create_task(work, name=name, context=self._context.copy())

    async def ask(self, work: Coroutine[Any, Any, Result], of: Service | None = None) -> Result:
        """Do some work as part of a service that lives, by default the newest: it is cancelled when that dies."""
        return await self._running_of(of).begin(work)

    def lines_of(self, service: Service) -> tuple[Line, Line]:
        """Return the ways from a service to the disk: the one for everything, and the one on which it renews leases."""
        running = self._running_of(service)
        return running.line, running.lease_line

    def _port_of_nobody(self) -> Port:
        """Return the first port that no living service has; the guard of a dead one may still hold it."""
        taken = {running.port.place for running in self._running if running.is_alive()}
        place = next(number for number in count() if number not in taken)
        if place == len(self._ports):
            self._ports.append(Port(self.fleet, place))
        return self._ports[place]

    def _running_of(self, service: Service | None) -> Running:
        if service is None:
            return self._running[-1]
        return next(running for running in self._running if running.service is service)

    async def _open(self, running: Running) -> Service:
        alive = running.is_alive

        async def database(settings: Settings) -> Database:
            backend = MemoryBackend(self.disk, alive, running.line)
            leases, name = None, f"service-{running.port.place}" if self._several else ""
            if self._several:
                beside = MemoryBackend(self.disk, alive, running.lease_line)
                table = MemoryLeaseTable(beside, me=new_token(8), name=name)
                leases = Leases(table, term_s=settings.lease_s, clock=self._loop.time)
            return await Database.on(backend, Spill(backend.url, [self.disk.folder], name), leases)

        ports = Ports(
            solver=lambda _settings: self.workers.solver(),
            database=database,
            fleet=FleetPorts(
                link=LinkPorts(endpoint=running.endpoint, messages=partial(MemoryMessages, alive=alive)),
                guard=running.new_guard,
            ),
            watch_loop=False,
        )
        clock = FleetClock(1.0, seconds=self._loop.time, utc=self._utc_s)
        return await Service.open(self._settings, clock, ports)

    def kill(self, service: Service | None = None) -> None:
        """End a service as SIGKILL does: none of it writes or sends anything from this moment on.

        Its guards then do what they were ordered to.
        """
        running = self._ended(service)
        self._die(running)
        self._burials.append(self.spawn(_bury(running.life), name="bury"))

    async def stop(self, service: Service | None = None) -> None:
        """Stop a service as SIGTERM does."""
        service = service or self.service
        if service is not None:
            running = self._ended(service)
            await running.begin(service.close())
            self._die(running)

    def _ended(self, service: Service | None) -> Running:
        running = self._running_of(service)
        if running.service is self.service:
            self.service = None
        running.service = None
        return running

    def _die(self, running: Running) -> None:
        for orders in running.die():
            work = carry_out(orders, running.port, self._loop.time, self._utc_s)
            self._guarding.append(self.spawn(work, name="guard"))

    async def register(self) -> None:
        """Register every vehicle of the fleet for the UAVs of the scenario, in their order."""
        assert self.service is not None, "no service lives"  # noqa: S101
        for system_id, uav_id in enumerate(self.scenario.uav_ids, start=1):
            await self.ask(self.service.fleet.register(uav_id, system_id))

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _fly(self) -> None:
        steps = 0
        began_s = self._loop.time()
        while True:
            steps += 1
            await asyncio.sleep(began_s + steps * STEP_S - self._loop.time())
            self.fleet.step_to(self._loop.time())
            self.after_step()

    def _utc_s(self) -> float:
        return EPOCH_S + self._loop.time() + self.clock_ahead_s


class _LoopClock:
    """The fleet's clock is the loop's."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def now(self) -> float:
        """Return virtual seconds."""
        return self._loop.time()


async def _bury(life: Life) -> None:
    """End the tasks of a dead service; what they do as they end has no effect. RuntimeError if one does not end."""
    for _ in range(BURIAL_TURNS):
        if not life.tasks:
            return
        for task in list(life.tasks.values()):
            task.cancel()
        await asyncio.sleep(0)
    raise RuntimeError(f"tasks of a dead service do not end: {', '.join(map(str, life.tasks.values()))}")
