"""Base stations over REST: what refusals mean to them, and which operation they serve."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import httpx2
import pytest

from skyfolio import sim
from skyfolio.api.client import ApiError, Client
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.fleet.simulated_fleet import fault_of, specs_at_starts
from skyfolio.api.flights.allocations import AllocationsView, SlotAllocation, UavAllocation
from skyfolio.api.flights.base_stations import BaseStations, radio_truth
from skyfolio.api.flights.measured_rates import Measurement
from skyfolio.api.lab.radio_client import RestPort
from skyfolio.api.lab.simulate import SimulateConfig, SimulateError, run_fleet
from skyfolio.planner import EXAMPLES

VIEW = {"operation_id": "op", "revision": 3, "plan_id": "p", "elapsed_s": 1.0, "paused": False, "uavs": {}}


def port(status: int, body: Any, seen: list[httpx2.Request] | None = None) -> RestPort:
    def answer(request: httpx2.Request) -> httpx2.Response:
        if seen is not None:
            seen.append(request)
        return httpx2.Response(status, json=body)

    http = httpx2.Client(transport=httpx2.MockTransport(answer), base_url="http://service")
    return RestPort(Client(http=http), "op")


def problem(status: int) -> dict[str, Any]:
    return {"type": "t", "title": "t", "status": status, "detail": "no"}


def test_an_operation_that_has_ended_has_nothing_to_serve() -> None:
    view = asyncio.run(port(200, VIEW).allocations())
    assert view is not None
    assert view.revision == 3
    assert asyncio.run(port(409, problem(409)).allocations()) is None
    with pytest.raises(ApiError):
        asyncio.run(port(503, problem(503)).allocations())


def test_a_stale_acknowledgement_is_no_error_and_anything_else_is() -> None:
    accepted = {"uav_id": "u", "revision": 3, "allocation": {"now": None, "next": None, "acknowledged": 3}}
    assert asyncio.run(port(200, accepted).acknowledge("u", 3)) is True
    assert asyncio.run(port(409, problem(409)).acknowledge("u", 2)) is False
    with pytest.raises(ApiError):
        asyncio.run(port(422, problem(422)).acknowledge("u", 9))


class Told:
    """A service that allocates everything to uav-1 in one revision, and what is acknowledged."""

    def __init__(self, revision: int) -> None:
        slot = SlotAllocation(slot=0, valid_from_s=0.0, valid_until_s=1e6, bandwidth_hz={"user-1": 1e4})
        uavs = {"uav-1": UavAllocation(now=slot, next=None), "uav-2": UavAllocation(now=None, next=None)}
        self.view = AllocationsView(
            operation_id="op", revision=revision, plan_id="p", elapsed_s=1.0, paused=False, uavs=uavs
        )
        self.acknowledged: list[tuple[str, int]] = []

    async def allocations(self) -> AllocationsView:
        return self.view

    async def acknowledge(self, uav_id: str, revision: int) -> bool:
        self.acknowledged.append((uav_id, revision))
        return True

    async def measure(self, measurements: Sequence[Measurement]) -> None:
        del measurements


def test_a_second_operation_is_served_though_its_revisions_begin_anew() -> None:
    scenario = EXAMPLES["minimal"]()
    fleet = sim.Fleet(specs_at_starts(scenario), clock=sim.ScaledClock(1.0))
    for revision in (9, 1):
        told = Told(revision)
        asyncio.run(BaseStations(fleet, radio_truth(fleet, scenario), told, {"uav-1": 1, "uav-2": 2}).step())
        assert told.acknowledged == [("uav-1", revision), ("uav-2", revision)]
        assert fleet.vehicles[1].base_station.serves(fleet.now_s) == {"user-1": 1e4}


def test_what_is_valid_stays_so_while_an_operation_is_paused() -> None:
    scenario = EXAMPLES["minimal"]()
    fleet = sim.Fleet(specs_at_starts(scenario), clock=sim.ScaledClock(1.0))
    told = Told(3)
    allocation = told.view.uavs["uav-1"]
    assert allocation.now is not None
    short = allocation.model_copy(update={"now": allocation.now.model_copy(update={"valid_until_s": 5.0})})
    told.view = told.view.model_copy(update={"paused": True, "uavs": {**told.view.uavs, "uav-1": short}})
    asyncio.run(BaseStations(fleet, radio_truth(fleet, scenario), told, {"uav-1": 1, "uav-2": 2}).step())
    assert fleet.vehicles[1].base_station.serves(fleet.now_s + 600.0) == {"user-1": 1e4}


def test_measurements_are_sent_as_they_are() -> None:
    seen: list[httpx2.Request] = []
    one = Measurement(uav_id="u", user_id="k", elapsed_s=2.5, rate_bps=0.0)
    asyncio.run(port(200, {"new": 1}, seen).measure([one]))
    assert seen[0].url.path == "/v1/operations/op/measurements"
    assert b'"rate_bps":0.0' in seen[0].content


def test_a_true_channel_that_cannot_be_is_refused_naming_the_option() -> None:
    with pytest.raises(SimulateError, match=r"--radio-channel: bias_db must be between"):
        asyncio.run(run_fleet(SimulateConfig(radio_channel="bias_db=500", as_json=True)))
    with pytest.raises(SimulateError, match=r"--radio-channel: .*colour"):
        asyncio.run(run_fleet(SimulateConfig(radio_channel="colour=3", as_json=True)))


def test_base_stations_that_serve_nobody_cannot_be_struck() -> None:
    with pytest.raises(InvalidError, match="'station_deaf' strikes a base station"):
        fault_of("station_deaf", 1, {}, stations=False)
    assert fault_of("station_deaf", 1, {}) == sim.StationDeaf(1)
