"""Drills of the service's own simulated fleet: real MAVLink on a real socket, in a thread of the service."""

import time
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.client import ApiError, Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.api.http.app import create_app
from skyfolio.planner import EXAMPLES
from tests.api.asking import events_of

SPEEDUP = 2.0
"""So slow that no UAV is silent for two wall seconds and a half because the machine is loaded."""


def wait_for(client: Client, operation_id: str, state: State) -> OperationView:
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline:
        view = client.operation(operation_id)
        if view.state == state:
            return view
        assert view.state != State.FAILED, view.error
        time.sleep(0.05)
    raise AssertionError(f"still {view.state}")


@pytest.mark.e2e
def test_a_drill_strikes_only_what_the_service_simulates_and_a_plan_made_ahead_answers_it() -> None:
    settings = Settings(simulate="minimal", time_scale=SPEEDUP, plan_ahead=False)
    with TestClient(create_app(settings)) as http:
        client = Client(http=http)
        assert {vehicle.simulated for vehicle in client.vehicles()} == {True}
        plan = client.plan(EXAMPLES["minimal"]().with_changes(slots=14))
        for slot in range(1, 13):
            assert client.contingencies(plan.id, at_slot=slot).complete
        operation = client.fly(plan.id, launch="manual")
        wait_for(client, operation.id, State.READY)
        assert client.drill(operation.id, "uav-2", at_slot=2).state == "scheduled"
        assert client.drill(operation.id, "uav-1", fault="station_deaf", at_slot=8).state == "scheduled"
        for refused in ({"fault": "earthquake"}, {"at_slot": 99}, {"strength": 9}):
            with pytest.raises(ApiError, match="422"):
                client.drill(operation.id, "uav-2", **refused)
        client.command(operation.id, "start")
        ended = wait_for(client, operation.id, State.COMPLETED)
        first, *others = ended.recoveries
        assert (first.cause, {report.cause for report in others}) == ("heartbeat_lost", {"rates_off"})
        assert {report.outcome for report in ended.recoveries} == {"flying"}
        assert first.source in {"planned_ahead", "solved"}  # what was measured by then may have corrected the channel
        assert {drill["state"] for drill in http.get("/v1/drills").json()["items"]} == {"struck"}
        track = http.get(f"/v1/operations/{operation.id}/track").json()
        assert len(track) > 50
        with pytest.raises(ApiError, match="409"):
            client.drill(operation.id, "uav-1")
        assert_served(ended, [event["data"] for event in events_of(http) if event["kind"] == "allocations"])


def assert_served(ended: OperationView, allocations: list[dict[str, Any]]) -> None:
    """The fleet's base stations have acknowledged and measured, until the last of them became deaf."""
    behind = [told["unacknowledged"] for told in allocations]
    assert behind[:3] == [[], [], []]
    assert behind[-1] == ["uav-1"]
    slots = {slot for measured in ended.measured_slots.values() for slot in measured}
    assert len(slots & set(range(12))) >= 9  # this machine may have been busy in one
    rates = ended.user_rates_bps.values()
    assert max(row[3] or 0.0 for row in rates) > 1000.0
    assert [row[12] or 0.0 for row in rates] == [0.0] * len(rates), "nobody told the deaf one to serve any more"
