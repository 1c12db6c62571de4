"""A service and a simulated fleet in one process, each with an event loop of its own, for tests that fly.

Both live at one pace (`tests.pacing`): seconds, here and in what tests wait for, are those of the pace.
"""

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.testclient import TestClient

from skyfolio import sim
from skyfolio.api.client import Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.fleet.simulated_fleet import specs_at_starts
from skyfolio.api.flights.operation_views import ENDED, OperationView, State
from skyfolio.api.http.app import create_app
from skyfolio.api.service import Service
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.planner import Plan, Scenario
from tests.pacing import PacedLoop, loop_options, pace
from tests.ports import free_port


class FleetThread:
    """A simulated fleet with an event loop of its own, as another process would be."""

    def __init__(
        self, scenario: Scenario, endpoint: str, speedup: float, absent: tuple[int, ...] = (), autopilot: str = "px4"
    ) -> None:
        specs = [spec for spec in specs_at_starts(scenario, autopilot) if spec.system_id not in absent]
        self.pace = pace(speedup)
        clock = self.pace.fleet_clock()
        self.fleet = sim.Fleet(specs, clock=clock, endpoint=endpoint, protocol_clock=self.pace)
        self._loop = PacedLoop(self.pace)
        self._until = asyncio.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        self._loop.run_until_complete(sim.serve(self.fleet, until=self._until))
        self._loop.close()

    def inject(self, fault: sim.Fault) -> None:
        self._loop.call_soon_threadsafe(self.fleet.inject, fault)

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._until.set)
        self._thread.join()


class Flight:
    """What a test needs of one flight."""

    def __init__(self, http: TestClient, fleet: FleetThread, scenario: Scenario) -> None:
        self.http, self.fleet, self.scenario = http, fleet, scenario
        self.client = Client(http=http)
        self.plan: Plan = self.client.plan(scenario)
        for number, uav in enumerate(scenario.uav_ids, start=1):
            self.client.register(uav, number)
        fleet.pace.until(lambda: all(vehicle.link == "live" for vehicle in self.client.vehicles()), "all are heard")

    def reached_by(self, http: TestClient) -> None:
        """Another service has taken over."""
        self.http, self.client = http, Client(http=http)

    @property
    def service(self) -> Service:
        app = self.http.app
        assert isinstance(app, FastAPI)
        made: Service = app.state.service
        return made

    def take_off(self, **options: Any) -> str:
        """Start the operation; its id once slot 0 has begun."""
        operation = self.client.fly(self.plan.id, **options)
        self.until(operation.id, lambda view: view.state == State.FLYING)
        return operation.id

    def until(self, operation_id: str, is_so: Callable[[OperationView], object], limit_s: float = 90) -> OperationView:
        """The operation once it is so; fails when it ended as failed, or after so many seconds."""
        views: list[OperationView] = []

        def now_so() -> bool:
            view = self.client.operation(operation_id)
            views[:] = [view]
            if is_so(view):
                return True
            assert view.state != State.FAILED, view.error
            return False

        self.fleet.pace.until(now_so, lambda: f"not so after {limit_s:g} s: {views}", within_s=limit_s)
        return views[0]

    def events(self, kind: str | None = None) -> list[dict[str, Any]]:
        """Every event of the service so far, or those of one kind."""
        return [event for event in events_of(self.http) if kind in (None, event["kind"])]

    def ended(self, operation_id: str) -> OperationView:
        """The operation when it is over."""
        return self.until(operation_id, lambda view: view.state in ENDED)


def events_of(http: TestClient) -> list[dict[str, Any]]:
    """Every event of a service so far, page by page."""
    found: list[dict[str, Any]] = []
    after: int | None = 0
    while after is not None:
        answer = http.get("/v1/events/log", params={"limit": 500, "after": after})
        assert answer.status_code == 200, answer.text
        page = answer.json()
        found, after = found + page["items"], page["next"]
    return found


def gone(client: Client, fleet: FleetThread) -> None:
    """Wait until the service misses the vehicles of a fleet that was stopped: those of the next test have their ids."""
    fleet.pace.until(lambda: all(vehicle.link == "lost" for vehicle in client.vehicles()), "all are missed")


@contextmanager
def serving(settings: Settings) -> Iterator[TestClient]:
    """A service that lives at the pace of its time scale."""
    speedup = settings.time_scale
    with TestClient(create_app(settings, clock=pace(speedup).clock()), backend_options=loop_options(speedup)) as http:
        yield http


@contextmanager
def service(speedup: float, **settings: Any) -> Iterator[tuple[TestClient, str]]:
    """A service that waits for vehicles, and where they have to send to."""
    port = free_port(socket.SOCK_DGRAM)
    chosen = Settings(fleet_url=f"udpin://127.0.0.1:{port}", time_scale=speedup, **settings)
    with serving(chosen) as http:
        yield http, f"udpout://127.0.0.1:{port}"


@contextmanager
def two_services(speedup: float, **settings: Any) -> Iterator[dict[Autopilot, tuple[TestClient, str]]]:
    """One for each autopilot, so that both can be flown side by side."""
    with ExitStack() as stack:
        made = {autopilot: stack.enter_context(service(speedup, **settings)) for autopilot in Autopilot}
        for http, _ in made.values():  # routes are built by the first request, which two threads must not make at once
            assert http.get("/openapi.json").status_code == 200
        yield made


def side_by_side(check: Callable[[Autopilot], None]) -> None:
    """Fly it with both autopilots at once, each in a thread: a flight mostly waits. Raises what went wrong."""
    with ThreadPoolExecutor(len(Autopilot)) as pool:
        flown = {autopilot: pool.submit(check, autopilot) for autopilot in Autopilot}
    errors = []
    for autopilot, one in flown.items():
        error = one.exception()
        if error is not None:
            error.add_note(f"on {autopilot.value}")
            errors.append(error)
    if errors:
        raise BaseExceptionGroup("side by side", errors)


@contextmanager
def flight(http: TestClient, endpoint: str, scenario: Scenario, speedup: float) -> Iterator[Flight]:
    """A fleet at the scenario's starts, a plan, and registered vehicles; what still flies is aborted at the end."""
    fleet, client = FleetThread(scenario, endpoint, speedup), Client(http=http)
    try:
        flown = Flight(http, fleet, scenario)
        yield flown
        client = flown.client  # of the service that has them now
        for row in flown.client.operations():
            if row.ended_at is None:
                flown.client.command(row.id, "abort")
    finally:
        fleet.stop()
        gone(client, fleet)
