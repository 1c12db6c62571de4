"""A service and a simulated fleet in one process, each with an event loop of its own, for tests that fly."""

import asyncio
import socket
import threading
import time
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
from tests.ports import free_port


class FleetThread:
    """A simulated fleet with an event loop of its own, as another process would be."""

    def __init__(
        self, scenario: Scenario, endpoint: str, speedup: float, absent: tuple[int, ...] = (), autopilot: str = "px4"
    ) -> None:
        specs = [spec for spec in specs_at_starts(scenario, autopilot) if spec.system_id not in absent]
        self.fleet = sim.Fleet(specs, clock=sim.ScaledClock(speedup), endpoint=endpoint)
        self._loop = asyncio.new_event_loop()
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
        deadline = time.monotonic() + 30
        while any(vehicle.link != "live" for vehicle in self.client.vehicles()):
            assert time.monotonic() < deadline, self.client.vehicles()
            time.sleep(0.05)

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
        """The operation once it is so; fails when it ended as failed, or after wall seconds."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            view = self.client.operation(operation_id)
            if is_so(view):
                return view
            assert view.state != State.FAILED, view.error
            time.sleep(0.05)
        raise AssertionError(f"not so after {limit_s:g} s: {view}")

    def ended(self, operation_id: str) -> OperationView:
        """The operation when it is over."""
        return self.until(operation_id, lambda view: view.state in ENDED)


def gone(client: Client) -> None:
    """Wait until the service misses its vehicles: those of the next test have the same ids."""
    deadline = time.monotonic() + 30
    while any(vehicle.link != "lost" for vehicle in client.vehicles()):
        assert time.monotonic() < deadline, client.vehicles()
        time.sleep(0.05)


@contextmanager
def service(speedup: float, **settings: Any) -> Iterator[tuple[TestClient, str]]:
    """A service that waits for vehicles, and where they have to send to."""
    port = free_port(socket.SOCK_DGRAM)
    chosen = Settings(fleet_url=f"udpin://127.0.0.1:{port}", time_scale=speedup, **settings)
    with TestClient(create_app(chosen)) as http:
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
        gone(client)
