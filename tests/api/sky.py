"""A service and a simulated fleet in virtual time, used by a test as by a client over HTTP.

Nothing waits and nothing runs beside the test: time passes only while the test asks for something, as fast as the
machine computes, so that no test depends on how loaded it is. All seconds are the fleet's.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import httpx2
from fastapi import FastAPI

from skyfolio import sim
from skyfolio.api.client import Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.flights.operation_views import ENDED, OperationView, State
from skyfolio.api.http.app import create_app
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import VirtualLoop
from skyfolio.api.service import Service
from skyfolio.planner import Plan, Scenario
from tests.api.asking import events_of

Result = TypeVar("Result")
LOOK_S = 0.25
"""Seconds between two looks of a test at what it waits for."""
LIMIT_S = 600.0
NO_LIMIT = 1_000_000_000
BASE_URL = "http://testserver"


@cache
def _app() -> FastAPI:
    """All services of this process live one after the other behind the same routes."""
    return create_app(Settings(rate_burst=NO_LIMIT))


@dataclass(frozen=True)
class Ask:
    """One request: `post("/v1/fleet:land")`."""

    method: str
    path: str
    json: Any = None
    headers: dict[str, str] | None = None


class _Transport(httpx2.BaseTransport):
    """Carries each request to the service of a sky, and lets time pass until it is answered."""

    def __init__(self, sky: Sky) -> None:
        self._sky = sky

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        return self._sky.run(self._sky.carry(request))


class Sky:
    """A ground with its loop, and a client of the service that lives on it."""

    def __init__(self, runner: asyncio.Runner, ground: Ground, scenario: Scenario) -> None:
        self._runner, self.ground, self.scenario = runner, ground, scenario
        self.http = httpx2.Client(transport=_Transport(self), base_url=BASE_URL)
        self.client = Client(http=self.http)
        self.plan: Plan

    # -- time -----------------------------------------------------------------------------------------------------

    def run(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Let time pass until some work is done; its result."""
        return self._runner.run(work)

    def let_pass(self, seconds: float) -> None:
        """Let that much time pass."""
        self.run(asyncio.sleep(seconds))

    @property
    def now_s(self) -> float:
        """Seconds since the sky began."""
        return self.ground.now_s

    def wait(self, is_so: Callable[[], object], what: str = "not so in time", *, within_s: float = LIMIT_S) -> None:
        """Let time pass until it is so. AssertionError after `within_s`."""
        until_s = self.now_s + within_s
        while not is_so():
            assert self.now_s < until_s, what
            self.let_pass(LOOK_S)

    # -- the service ----------------------------------------------------------------------------------------------

    @property
    def service(self) -> Service:
        """The service that lives."""
        assert self.ground.service is not None
        return self.ground.service

    def start(self) -> None:
        """Start a service on the disk as it is."""
        _app().state.service = self.run(self.ground.start())

    def stop(self) -> None:
        """Stop the service, as SIGTERM does."""
        self.run(self.ground.stop())

    def register_and_plan(self) -> None:
        """Plan the scenario, register its UAVs, and wait until all are heard."""
        self.plan = self.client.plan(self.scenario)
        for number, uav in enumerate(self.scenario.uav_ids, start=1):
            self.client.register(uav, number)
        self.wait(lambda: all(vehicle.link == "live" for vehicle in self.client.vehicles()), "all are heard")

    async def carry(self, request: httpx2.Request) -> httpx2.Response:
        """The answer of the service that lives to one request."""

        async def ask() -> httpx2.Response:
            answer = await httpx2.ASGITransport(_app()).handle_async_request(request)
            assert isinstance(answer.stream, httpx2.AsyncByteStream)
            body = b"".join([part async for part in answer.stream])
            return httpx2.Response(answer.status_code, headers=answer.headers, content=body)

        return await self.ground.ask(ask())

    def at_once(self, asked: Sequence[Ask]) -> list[httpx2.Response]:
        """The answers to requests of which none waits for another."""
        requests = [self.http.build_request(one.method, one.path, json=one.json, headers=one.headers) for one in asked]

        async def all_of_them() -> list[httpx2.Response]:
            return await asyncio.gather(*map(self.carry, requests))

        return self.run(all_of_them())

    # -- the fleet ------------------------------------------------------------------------------------------------

    @property
    def fleet(self) -> sim.Fleet:
        """The simulated fleet."""
        return self.ground.fleet

    def inject(self, *faults: sim.Fault) -> None:
        """Let these faults strike now."""
        for fault in faults:
            self.fleet.inject(fault)

    def set_parameters(self, values: Mapping[str, float], *system_ids: int) -> None:
        """Give these vehicles (without any: all) these parameters, as their owner did."""
        for system_id in system_ids or self.fleet.vehicles:
            parameters = self.fleet.vehicles[system_id].autopilot.parameters
            for name, value in values.items():
                parameters[name] = value

    # -- operations -----------------------------------------------------------------------------------------------

    def take_off(self, **options: Any) -> str:
        """Start the operation; its id once slot 0 has begun."""
        operation = self.client.fly(self.plan.id, **options)
        self.until(operation.id, lambda view: view.state == State.FLYING)
        return operation.id

    def look_at(self, operation_id: str) -> OperationView:
        """The operation as `client.operation` reads it, but not over HTTP: looking at it would be most of a test."""
        return self.run(self.ground.ask(self.service.operations.view(operation_id), self.service))

    def until(
        self,
        operation_id: str,
        is_so: Callable[[OperationView], object],
        *,
        within_s: float = LIMIT_S,
        fails: bool = False,
    ) -> OperationView:
        """The operation once it is so. AssertionError after `within_s`, or when it fails (unless it may: `fails`)."""
        until_s = self.now_s + within_s
        while True:
            view = self.look_at(operation_id)
            if is_so(view):
                return view.model_copy(deep=True)
            assert fails or view.state != State.FAILED, view.error
            assert self.now_s < until_s, f"not so after {within_s:g} s: {view}"
            self.let_pass(LOOK_S)

    def ended(self, operation_id: str) -> OperationView:
        """The operation when it is over, however it ended."""
        return self.until(operation_id, lambda view: view.state in ENDED, fails=True)

    def events(self, kind: str | None = None) -> list[dict[str, Any]]:
        """Every event so far, or those of one kind."""
        return [event for event in events_of(self.http) if kind in (None, event["kind"])]

    def told(self, operation_id: str, kind: str) -> list[dict[str, Any]]:
        """Data of the events of a kind since this operation was made."""
        found = self.events()
        first = next(event["id"] for event in found if event["data"].get("operation_id") == operation_id)
        return [event["data"] for event in found if event["kind"] == kind and event["id"] >= first]


@contextmanager
def sky(
    scenario: Scenario, *, autopilots: Iterable[str] = (), absent: Iterable[int] = (), seed: int = 1, **settings: Any
) -> Iterator[Sky]:
    """A service with a fleet at the scenario's starts, on the ground; nothing is planned or registered yet."""
    specs = [spec for spec in Ground.specs_of(scenario, autopilots) if spec.system_id not in set(absent)]
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        ground = runner.run(_ground(scenario, specs, seed, settings))
        made = Sky(runner, ground, scenario)
        try:
            runner.run(ground.__aenter__())
            made.start()
            yield made
        finally:
            runner.run(ground.__aexit__(None, None, None))
    assert ground.alive_tasks == []


async def _ground(scenario: Scenario, specs: list[sim.VehicleSpec], seed: int, settings: dict[str, Any]) -> Ground:
    """Made where a loop runs: its clock is the fleet's."""
    return Ground(scenario, specs=specs, seed=seed, rate_burst=NO_LIMIT, **settings)


@contextmanager
def flight(scenario: Scenario, **options: Any) -> Iterator[Sky]:
    """A sky whose vehicles are registered, heard and planned for."""
    with sky(scenario, **options) as made:
        made.register_and_plan()
        yield made
