"""The parts of one running service, made and ended together."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

import structlog

from api.attempts import Door
from api.clock import FleetClock
from api.contingencies import Contingencies
from api.drills import Drills
from api.errors import BusyError
from api.events import Event, EventLog
from api.fleet import Fleet
from api.journal import Entry, Journal
from api.metrics import Metrics
from api.operation_rows import Books
from api.operations import Operations
from api.plan_book import PlanBook
from api.plan_store import PlanStore
from api.resilience import Parts
from api.security import KeyRing
from api.settings import Settings
from api.simulated import SimulatedFleet, own_endpoint, scenario_of
from api.solver import LaneName, SolveError, Solver
from api.solving import Job
from api.store import Database, StoreError
from planner import EXAMPLES

log = structlog.get_logger()
PULSE_S = 5.0
TIDY_S = 60.0
TEND_S = 0.5


class Service:
    """Everything a route may use. Made by `open`, ended by `close`."""

    def __init__(self, settings: Settings, database: Database, events: EventLog) -> None:
        self.settings, self.database, self.events = settings, database, events
        self.clock = FleetClock(settings.time_scale)
        self.metrics = Metrics()
        self.keys = KeyRing(database)
        self.door = Door(self.keys, settings.failed_keys_per_minute)
        self.solver = Solver(settings.workers, settings.queue_limit)
        self.plans = PlanBook(self.solver, events, PlanStore(database), settings)
        self.contingencies = Contingencies(self.solver, database)
        self.journal = Journal(database)
        self.simulated, settings = _simulated(settings)
        self.fleet = Fleet(settings, self.clock, events, database, healthy=self.can_replan)
        parts = Parts(settings, self.clock, self.plans, self.contingencies, self.metrics)
        self.operations = Operations(parts, Books(database, self.journal, events), self.fleet)
        self.drills = Drills(self.fleet, self.operations, events, database, self.simulated)
        self.ready = False
        self._pulse = (-PULSE_S, 0.0)
        self._pulsing = asyncio.Lock()
        self._tasks: list[asyncio.Task[None]] = []
        self.plans.on_solved = self._note_solve
        events.listeners.append(self._note_event)
        self.journal.listeners.append(self._note_step)

    @classmethod
    async def open(cls, settings: Settings) -> Service:
        """Open the database, warm the solver, and go on with what an earlier process left. Raises StoreError."""
        database = await Database.open(settings.database_url)
        try:
            await database.claim()
            service = cls(settings, database, await EventLog.open(database))
        except BaseException:
            await database.close()
            raise
        try:
            await service._start()
        except BaseException:
            await service.close()
            raise
        return service

    async def _start(self) -> None:
        self.events.add("service_started")
        self._tasks = [
            asyncio.create_task(self.metrics.watch_loop(), name="loop-watch"),
            asyncio.create_task(self._show_telemetry(), name="telemetry"),
            asyncio.create_task(self._tidy(), name="tidy"),
            asyncio.create_task(self._tend_solver(), name="tend-solver"),
        ]
        await self.plans.start()
        await self.drills.start_up()
        await self.fleet.start()
        if self.settings.warm_up:
            self._tasks.append(asyncio.create_task(self.solver.warm_up(), name="warm-up"))
        await self.operations.start_up()  # before the solver is warm: vehicles in the air wait for nothing
        if self.simulated is not None:
            self.simulated.start()
            for system_id, uav_id in enumerate(scenario_of(str(self.settings.simulate)).uav_ids, start=1):
                await self.fleet.register(uav_id, system_id, simulated=True)
        self.ready = True

    async def close(self) -> None:
        """End operations (vehicles go on with the mission on board), the link, the workers, the database."""
        self.ready = False
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.drills.close()
        await self.operations.close()
        await self.fleet.close()
        if self.simulated is not None:
            await asyncio.to_thread(self.simulated.stop)
        await self.contingencies.close()
        await self.plans.close()
        await asyncio.to_thread(self.solver.close)
        await self.database.close()

    # -- how it is ------------------------------------------------------------------------------------------------

    async def pulse(self) -> float:
        """Milliseconds of a tiny solve, from asking to result, at most some seconds old. Raises BusyError."""
        async with self._pulsing:
            at, took_ms = self._pulse
            if time.monotonic() - at < PULSE_S:
                return took_ms
            began = time.monotonic()
            try:
                await self.solver[LaneName.FLIGHT].solve(
                    Job(scenario=EXAMPLES["minimal"]().model_dump_json(), deadline_s=PULSE_S)
                )
            except SolveError as error:
                raise BusyError(f"solver: {error}") from error
            now = time.monotonic()
            self._pulse = (now, (now - began) * 1e3)
            return self._pulse[1]

    def can_replan(self) -> bool:
        """Whether the workers that replan in flight answer: only then do vehicles hear our HEARTBEAT."""
        return self.solver[LaneName.FLIGHT].answers

    async def readiness(self) -> dict[str, str]:
        """What is needed to serve requests, each 'ok' or what is wrong."""
        checks = {"service": "ok" if self.ready else "starting"}
        try:
            await self.keys.all()
            checks["database"] = "ok"
        except StoreError as error:
            checks["database"] = str(error)[:200]
        cold = self.settings.warm_up and len(self.solver.warm) < len(self.solver.lanes)
        silent = [name.value for name, lane in self.solver.lanes.items() if not lane.answers]
        checks["solver"] = f"no answer from {' and '.join(silent)}" if silent else "warming up" if cold else "ok"
        checks["heartbeat"] = "ok" if self.can_replan() else "not sent to vehicles: nobody could replan"
        lane = self.solver[LaneName.REQUESTS]
        checks["queue"] = "ok" if lane.busy < self.settings.queue_limit else "full"
        return checks

    def measured(self) -> bytes:
        """The metrics, with those that are only known when asked."""
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
            said = entry.model_dump(mode="json", include={"operation_id", "incident", "step", "uav_id", "data"})
            self.events.add("incident", **said)
            log.info("incident", **{name: value for name, value in said.items() if value is not None})

    # -- what goes on beside --------------------------------------------------------------------------------------

    async def _show_telemetry(self) -> None:
        """Pictures of all vehicles for those who listen."""
        while True:
            await asyncio.sleep(1 / self.settings.telemetry_hz)
            if self.events.followers and not self.fleet.empty:
                vehicles = [view.model_dump(mode="json") for view in self.fleet.views()]
                self.events.picture({"at": round(time.time(), 3), "vehicles": vehicles})

    async def _tend_solver(self) -> None:
        """Replace workers that do not answer, and tell when vehicles stop and begin to hear our HEARTBEAT."""
        sent = True
        while True:
            await asyncio.sleep(TEND_S)
            if sent != self.can_replan():
                sent = not sent
                self.events.add("gcs_heartbeat", sent=sent, because="" if sent else "the solver workers do not answer")
            await asyncio.gather(*(lane.tend() for lane in self.solver.lanes.values()))

    async def _tidy(self) -> None:
        """Forget ended plans in time."""
        while True:
            await asyncio.sleep(min(TIDY_S, self.settings.keep_ended_s))
            with suppress(StoreError):
                gone = await self.plans.forget_ended(time.time() - self.settings.keep_ended_s)
                if gone:
                    log.info("plans forgotten", count=gone)


def _simulated(settings: Settings) -> tuple[SimulatedFleet | None, Settings]:
    """The service's own fleet, if it has one, and the settings that lead to it."""
    if settings.simulate is None:
        return None, settings
    endpoint = own_endpoint()
    fleet = SimulatedFleet(scenario_of(settings.simulate), endpoint, settings.time_scale)
    return fleet, settings.model_copy(update={"fleet_url": f"udpin://{endpoint}"})
