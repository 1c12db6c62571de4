"""A service and a simulated fleet in one process, each with an event loop of its own, for tests that fly.

Both live at one pace (`tests.pacing`): seconds, here and in what tests wait for, are those of the pace.
"""

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.testclient import TestClient

from skyfolio import sim
from skyfolio.api.client import Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.fleet.simulated_fleet import specs_at_starts
from skyfolio.api.http.app import create_app
from skyfolio.api.service import Service
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

    @property
    def service(self) -> Service:
        app = self.http.app
        assert isinstance(app, FastAPI)
        made: Service = app.state.service
        return made


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
