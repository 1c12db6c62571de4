"""Whole operations over HTTP and real sockets, by mission and by stream, on both autopilots."""

from __future__ import annotations

import socket
from math import hypot
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.common.settings import Settings
from skyfolio.planner import EXAMPLES
from tests.api.asking import events_of, planned
from tests.api.flying import FleetThread, serving
from tests.pacing import pace
from tests.ports import free_port

LOW = EXAMPLES["minimal"]().with_changes(slots=8, altitude_m=8.0)


def follow(client: TestClient, path: str, *states: str, speedup: float) -> dict[str, Any]:
    pace(speedup).until(lambda: client.get(path).json()["state"] in states, lambda: client.get(path).text)
    operation: dict[str, Any] = client.get(path).json()
    return operation


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("autopilot", "guidance", "at_end"), [("px4", "stream", "land"), ("ardupilot", "mission", "return")]
)
def test_both_autopilots_fly_by_mission_or_stream_tell_their_slip_and_end_as_ordered(
    autopilot: str, guidance: str, at_end: str
) -> None:
    port, speedup = free_port(socket.SOCK_DGRAM), 5.0  # a stream must not pause for a second of the fleet's time
    with serving(Settings(fleet_url=f"udpin://127.0.0.1:{port}", time_scale=speedup)) as client:
        fleet = FleetThread(LOW, f"udpout://127.0.0.1:{port}", speedup, autopilot=autopilot)
        if autopilot == "px4":
            for vehicle in fleet.fleet.vehicles.values():
                vehicle.autopilot.parameters["COM_OBL_RC_ACT"] = 5  # else no stream
        try:
            order = {"plan_id": planned(client, LOW), "guidance": guidance, "at_end": at_end}
            path = client.post("/v1/operations", json=order).headers["Location"]
            ended = follow(client, path, "completed", "failed", speedup=speedup)
            assert ended["error"] is None
            assert ended["lost"] == []  # a return and a landing at the end are as planned
            log = events_of(client)
            slips = [event["data"] for event in log if event["kind"] == "slip"]
            assert {slip["uav_id"] for slip in slips} == {"uav-1", "uav-2"}
            assert {slip["slot"] for slip in slips} >= {1, 2, 3, 4, 5}
            figures = client.get("/metrics").text
            for uav in ("uav-1", "uav-2"):
                told = float(sum(slip["uav_id"] == uav for slip in slips))
                late = float(sum(slip["uav_id"] == uav and slip["late_s"] is not None for slip in slips))
                assert f'skyfolio_slot_distance_metres_count{{uav="{uav}"}} {told}' in figures
                assert f'skyfolio_slot_lateness_seconds_count{{uav="{uav}"}} {late}' in figures
            modes = {event.detail["mode"] for event in fleet.fleet.truth.happened("mode")}
            assert ("GUIDED" in modes) == (guidance == "stream" or autopilot == "ardupilot")
            for system_id, uav in enumerate(("uav-1", "uav-2"), start=1):
                assert fleet.fleet.truth.happened("landed", system_id)
                body, plan = fleet.fleet.vehicles[system_id].autopilot.body, client.get(f"/v1/plans/{order['plan_id']}")
                (east_m, north_m), (end_east_m, end_north_m) = (plan.json()["trajectories_m"][uav][n] for n in (0, -1))
                home_m = hypot(end_east_m - east_m, end_north_m - north_m)
                assert home_m > 10.0
                assert body.distance_to(0.0, 0.0) == pytest.approx(0.0 if at_end == "return" else home_m, abs=4.0)
            assert any(event["kind"] == "preflight" for event in log)
        finally:
            fleet.stop()
