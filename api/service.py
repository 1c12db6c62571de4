"""The parts of one running service, made and ended together."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import structlog

from skyfolio.api.access.api_keys import KeyRing
from skyfolio.api.access.audit_log import AuditLog
from skyfolio.api.access.key_attempts import KeyAuthenticator
from skyfolio.api.common.configuration import simulated_channel, simulated_field, simulated_scenario
from skyfolio.api.common.errors import BusyError
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.metrics import Metrics
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.common.surroundings import monotonic_s, utc_s
from skyfolio.api.fleet.fleet_ports import FleetPorts
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.fleet.simulated_fleet import SimulatedFleet, own_endpoint
from skyfolio.api.flights.drills import Drills
from skyfolio.api.flights.journal import Entry, Journal
from skyfolio.api.flights.operation_store import Stores
from skyfolio.api.flights.operations import Operations
from skyfolio.api.flights.orders import Orders
from skyfolio.api.flights.own_stations import OwnStations
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.plans.contingencies import Contingencies
from skyfolio.api.plans.explanations import Explanations
from skyfolio.api.plans.jobs import Job
from skyfolio.api.plans.lane_port import SolveLane
from skyfolio.api.plans.plan_book import PlanBook
from skyfolio.api.plans.plan_store import PlanStore
from skyfolio.api.plans.solver import LaneName, Solver
from skyfolio.api.plans.solver_choice import solver_for
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.event_log import Event, EventLog
from skyfolio.api.store.leases import Leases
from skyfolio.api.store.retention import Retention
from skyfolio.api.webhooks.delivery import Deliveries, Post, post
from skyfolio.api.webhooks.hooks import Hooks
from skyfolio.planner import EXAMPLES

log = structlog.get_logger()
PULSE_S = 5.0
TIDY_S = 60.0
TEND_S = 0.5
CLOSE_S = 1.5
"""Wall seconds that everything has to end when the service is stopped: vehicles fly on by themselves."""


async def _open_database(settings: Settings) -> Database:
    return await Database.open(settings.database_url, Leases.of(settings) if settings.several_services else None)


@dataclass(frozen=True, kw_only=True)
class Ports:
    """What a service reaches the world through; by default what a process of its own has.

    solver: makes the lanes of solves. database: opens the database that the settings name. watch_loop: whether it is
    worth measuring how late the event loop wakes. post: sends a delivery to the receiver of a webhook.
    """

    solver: Callable[[Settings], Solver] = solver_for
    database: Callable[[Settings], Awaitable[Database]] = _open_database
    fleet: FleetPorts = field(default_factory=FleetPorts)
    watch_loop: bool = True
    post: Post = post


class Service:
    """Everything that a route may use. Made by `open`, ended by `close`."""

    def __init__(
        self,
        settings: Settings,
        database: Database,
        events: EventLog,
        solver: Solver,
        clock: FleetClock | None = None,
        ports: Ports | None = None,
    ) -> None:
        self.settings, self.database, self.events = settings, database, events
        self._ports = ports or Ports()
        self.clock = clock or FleetClock(settings.time_scale)
        self.metrics = Metrics()
        self.keys = KeyRing(database)
        self.audit = AuditLog(database)
        self.authenticator = KeyAuthenticator(self.keys, settings.failed_keys_per_minute)
        self.background = Supervisor(events.add)
        self.solver = solver
        self.plans = PlanBook(self.solver, events, PlanStore(database), settings)
        self.contingencies = Contingencies(self.solver, database)
        self.explanations = Explanations(self.solver, settings)
        self.journal = Journal(database)
        self.simulated, settings = _simulated(settings)
        self.fleet = Fleet(
            settings,
            self.clock,
            events,
            database,
            background=self.background,
            healthy=self.can_replan,
            ports=self._ports.fleet,
            leases=database.leases,
        )
        shared = SharedServices(settings, self.clock, self.plans, self.contingencies, self.metrics)
        self.operations = Operations(shared, Stores(database, self.journal, events), self.fleet)
        self.orders = Orders(self.fleet, self.operations)
        self.drills = Drills(self.fleet, self.operations, events, database, self.simulated)
        self.webhooks = Hooks(database)
        self.deliveries = Deliveries(self.webhooks, events, database, self._ports.post)
        self.ready = False
        self._pulse: tuple[float, float] | None = None
        self._pulsing: asyncio.Task[None] | None = None
        self.plans.on_solved = self._note_solve
        events.listeners.append(self._note_event)
        self.journal.listeners.append(self._note_step)

    @classmethod
    async def open(cls, settings: Settings, clock: FleetClock | None = None, ports: Ports | None = None) -> Service:
        """Warm the solver, open the database, and go on with what an earlier process left. Raises StoreError.

        Workers load while the rest starts: the sooner the lane of flights is warm, the sooner a loss is dealt with.
        clock: the fleet's time, when it is a simulated fleet's own. ports: what it reaches the world through.
        """
        ports = ports or Ports()
        solver = ports.solver(settings)
        if settings.warm_up:
            solver.begin()
        database = None
        try:
            database = await ports.database(settings)
            await database.claim()
            service = cls(settings, database, await EventLog.open(database), solver, clock, ports)
        except BaseException:
            if database is not None:
                await database.close()
            await asyncio.to_thread(solver.close)
            raise
        try:
            await service._start()
        except BaseException:
            await service.close()
            raise
        return service

    async def _start(self) -> None:
        self.events.add("service_started", taken_up=self.database.taken_up)
        self.background.watch_loop(asyncio.get_running_loop())
        if self._ports.watch_loop:
            self.background.start("loop-watch", self.metrics.watch_loop)
        self.background.start("telemetry", self._show_telemetry)
        self.background.start("tidy", self._tidy)
        self.background.start("webhooks", self.deliveries.run)
        self.background.start("tend-solver", self._tend_solver)
        if self.solver.link is not None:
            self.solver.link.tell = self.events.add
            self.background.start("dask", self.solver.link.keep)
        if self.settings.warm_up:
            self.background.start("warm-up", self.solver.warm_up)
        await self.plans.start()
        await self.drills.start_up()
        await self.fleet.start()
        await self._start_leases()
        await self.operations.start_up()  # before the solver is warm: vehicles in the air wait for nothing
        if self.simulated is not None:
            self.simulated.start()
            for system_id, uav_id in enumerate(self.simulated.uav_ids, start=1):
                await self.fleet.register(uav_id, system_id, simulated=True)
            if self.simulated.stations:
                channel = simulated_channel(self.settings.simulate_channel)
                stations = OwnStations(self.simulated, self.fleet, self.operations, channel)
                self.background.start("base-stations", stations.run)
        self.ready = True

    async def _start_leases(self) -> None:
        """Begin to hold leases, and to follow what other services do, if several share the database."""
        leases = self.database.leases
        if leases is None:
            return
        await leases.start()
        for name, work in {
            "leases": leases.run,
            "lease-watch": leases.watch,
            "events-of-others": self.events.follow_others,
            "registry-of-others": self.fleet.follow_registry,
            "operations-of-others": self.operations.follow_others,
        }.items():
            self.background.start(name, work)

    async def close(self) -> None:
        """End operations, the link, the workers and the database; vehicles go on with the missions on board.

        A part that hangs is left behind: together they take at most CLOSE_S, and a little more for the database.
        """
        self.ready = False
        self.events.end()
        until_s = monotonic_s() + CLOSE_S
        await _ended("background", self.background.close(), until_s)
        await _ended("drills", self.drills.close(), until_s)
        await _ended("operations", self.operations.close(), until_s)
        await _ended("fleet", self.fleet.close(), until_s)
        if self.database.leases is not None:  # nothing is sent any more
            await _ended("leases", self.database.leases.close(), until_s)
        if self.simulated is not None:
            await _ended("simulated fleet", asyncio.to_thread(self.simulated.stop), until_s)
        await _ended("contingencies", self.contingencies.close(), until_s)
        await _ended("explanations", self.explanations.close(), until_s)
        await _ended("plans", self.plans.close(), until_s)
        await asyncio.to_thread(self.solver.close)
        await _ended("database", self.database.close(), monotonic_s() + 1.0)

    # -- health and metrics ---------------------------------------------------------------------------------------

    async def pulse(self) -> float | None:
        """Return the milliseconds of a tiny solve, from request to result; None before the first.

        The last one is repeated if it is some seconds old and no client's job is in its way. While the workers start
        there is none (`readiness` says so). Raises BusyError if workers that have answered before do not.
        """
        lane = self.solver[LaneName.REQUESTS]
        if self._pulse is None and not lane.warm:
            return None
        fresh = self._pulse is not None and monotonic_s() - self._pulse[0] < PULSE_S
        if not fresh and (self._pulsing is not None or not lane.busy):
            self._pulsing = self._pulsing or asyncio.create_task(self._feel_pulse(lane), name="pulse")
            await asyncio.wait([self._pulsing], timeout=PULSE_S)
            if self._pulsing is not None and not self._pulsing.done():
                raise BusyError("solver: its workers are still starting")
            done, self._pulsing = self._pulsing, None
            if done is not None and (error := done.exception()) is not None:
                raise BusyError(f"solver: {error}") from error
        elif not lane.answers:
            raise BusyError("solver: its workers do not answer")
        return None if self._pulse is None else self._pulse[1]

    async def _feel_pulse(self, lane: SolveLane) -> None:
        began_s = monotonic_s()
        await lane.solve(Job(scenario=EXAMPLES["minimal"]().model_dump_json(), deadline_s=PULSE_S))
        now_s = monotonic_s()
        self._pulse = (now_s, (now_s - began_s) * 1e3)

    def can_replan(self) -> bool:
        """Return whether the workers that replan in flight answer: only then is our HEARTBEAT sent to vehicles."""
        return self.solver[LaneName.FLIGHT].answers

    async def readiness(self) -> dict[str, str]:
        """Return what is needed to serve requests, each 'ok', 'ok: ' and what is to be known, or what is wrong."""
        checks = {"service": "ok" if self.ready else "starting"}
        try:
            await self.keys.all()
            trouble = self.database.trouble
            held = f"; {self.database.held} writes of flights are held" if trouble else ""
            checks["database"] = "ok" if trouble is None else f"degraded: {trouble}{held}"
        except StoreError as error:
            checks["database"] = str(error)[:200]
        if self.database.leases is not None:
            checks["leases"] = self.database.leases.state
        checks["solver"] = self._solver_check()
        if (link := self.solver.link) is not None and not link.up:
            checks["cluster"] = f"ok: local workers solve instead; {link.trouble}"
        troubles = self.background.troubles
        checks["tasks"] = "; ".join(f"{name} failed ({error})" for name, error in troubles.items()) or "ok"
        checks["heartbeat"] = "ok" if self.can_replan() else "not sent to vehicles: no worker can replan"
        lane = self.solver[LaneName.REQUESTS]
        checks["queue"] = "ok" if lane.busy < self.settings.queue_limit else "full"
        return checks

    def _solver_check(self) -> str:
        silent = [name.value for name, lane in self.solver.lanes.items() if not lane.answers]
        if silent:
            return f"no answer from {' and '.join(silent)}"
        return "warming up" if self.settings.warm_up and not self.solver.warm else "ok"

    def measured(self) -> bytes:
        """Return the metrics, with those that are only measured on request."""
        for name, lane in self.solver.lanes.items():
            self.metrics.solves_waiting.labels(name.value).set(lane.busy)
            self.metrics.solver_answers.labels(name.value).set(lane.answers)
        for vehicle in self.fleet.views():
            if vehicle.silent_for_s is not None:
                self.metrics.heartbeat_age.labels(vehicle.uav_id).set(vehicle.silent_for_s)
        return self.metrics.text()

    def _note_solve(self, kind: str, seconds: float, iterations: int) -> None:
        self.metrics.solve.labels(kind).observe(seconds)
        self.metrics.iterations.labels(kind).observe(iterations)

    def _note_event(self, event: Event) -> None:
        self.metrics.events.labels(event.kind).inc()
        if event.kind == "slip":
            self.metrics.note_slip(event.data["uav_id"], event.data["distance_m"], event.data["late_s"])

    def _note_step(self, entry: Entry, stored: bool) -> None:
        if stored:
            data = entry.model_dump(mode="json", include={"operation_id", "incident", "step", "uav_id", "data"})
            self.events.add("incident", **data)
            log.info("incident", **{name: value for name, value in data.items() if value is not None})

    # -- background tasks -----------------------------------------------------------------------------------------

    async def _show_telemetry(self) -> None:
        """Send the state of all vehicles to clients that listen."""
        while True:
            await asyncio.sleep(1 / self.settings.telemetry_hz)
            if self.events.followers and not self.fleet.empty:
                vehicles = [view.model_dump(mode="json") for view in self.fleet.views()]
                self.events.publish_telemetry({"at": round(utc_s(), 3), "vehicles": vehicles})

    async def _tend_solver(self) -> None:
        """Replace workers that do not answer, and report when our HEARTBEAT to vehicles stops and begins."""
        sent = True
        while True:
            await asyncio.sleep(TEND_S)
            if sent != self.can_replan():
                sent = not sent
                self.events.add("gcs_heartbeat", sent=sent, because="" if sent else "the solver workers do not answer")
            await asyncio.gather(*(lane.tend() for lane in self.solver.lanes.values()))

    async def _tidy(self) -> None:
        """Delete what is kept only for a while."""
        retention = Retention(self.database, self.settings)
        while True:
            await asyncio.sleep(min(TIDY_S, self.settings.keep_ended_s))
            with suppress(StoreError):
                await retention.tidy(self.plans.forget_ended)


async def _ended(name: str, ending: Coroutine[Any, Any, None], until_s: float) -> None:
    """Wait for an end, but hardly longer than `until_s` (monotonic seconds)."""
    task = asyncio.create_task(ending, name=f"end {name}")
    done, _ = await asyncio.wait([task], timeout=max(0.1, until_s - monotonic_s()))
    if done:
        task.result()
    else:
        log.warning("did not end in time and is left behind", what=name)
        task.cancel()


def _simulated(settings: Settings) -> tuple[SimulatedFleet | None, Settings]:
    """Return the service's own simulated fleet, if it has one, and the settings that lead to it."""
    if settings.simulate is None:
        return None, settings
    endpoint = own_endpoint()
    scenario, joined = simulated_scenario(settings.simulate), settings.simulate_stations
    fleet = SimulatedFleet(scenario, endpoint, settings.time_scale, stations=joined, field=simulated_field(settings))
    return fleet, settings.model_copy(update={"fleet_url": f"udpin://{endpoint}"})
