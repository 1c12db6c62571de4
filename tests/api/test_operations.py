"""Operations over HTTP against simulated vehicles on real sockets."""

import socket
from collections.abc import Iterator
from math import hypot
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio import sim
from skyfolio.api.common.settings import Settings
from skyfolio.planner import EXAMPLES, Scenario
from tests.api.flying import FleetThread, events_of, serving
from tests.pacing import pace
from tests.ports import free_port

SPEEDUP = 10.0
MINIMAL = EXAMPLES["minimal"]().with_changes(slots=8)
LOW = MINIMAL.with_changes(altitude_m=8.0)
LONG = LOW.with_changes(slots=16)
"""With time for a new plan: the wall second in which one is made and uploaded is 10 s of this fleet's."""
PATIENT: dict[str, Any] = {"heartbeat_stale_s": 6.0, "heartbeat_lost_s": 10.0}
"""A wall second of silence: a loaded machine must not lose a vehicle by itself."""


def simulated(endpoint: str, absent: tuple[int, ...] = ()) -> FleetThread:
    return FleetThread(MINIMAL, endpoint, SPEEDUP, absent)


@pytest.fixture
def service() -> Iterator[tuple[TestClient, str]]:
    """A service that has never heard of any vehicle, and where they have to send to."""
    port = free_port(socket.SOCK_DGRAM)
    settings = Settings(fleet_url=f"udpin://127.0.0.1:{port}", time_scale=SPEEDUP, **PATIENT)
    with serving(settings) as client:
        yield client, f"udpout://127.0.0.1:{port}"


def ready(client: TestClient, flown: Scenario = MINIMAL) -> str:
    for system_id, uav in enumerate(flown.uavs, start=1):
        body = {"uav_id": uav.id, "system_id": system_id}
        assert client.post("/v1/fleet/vehicles", json=body).status_code == 201
    scenario = flown.model_dump(mode="json")
    made: str = client.post("/v1/plans", params={"wait_s": 60}, json=scenario).json()["id"]
    return made


def follow(client: TestClient, path: str, *states: str, speedup: float = SPEEDUP) -> dict[str, Any]:
    pace(speedup).until(lambda: client.get(path).json()["state"] in states, lambda: client.get(path).text)
    operation: dict[str, Any] = client.get(path).json()
    return operation


def test_a_vehicle_that_never_answers_fails_the_upload_by_name(service: tuple[TestClient, str]) -> None:
    client, endpoint = service
    fleet = simulated(endpoint, absent=(2,))
    try:
        plan_id = ready(client)
        answer = client.post("/v1/operations", json={"plan_id": plan_id})
        assert answer.status_code == 202
        ended = follow(client, answer.headers["Location"], "failed", "completed")
        assert ended["state"] == "failed"
        assert "upload failed for 'uav-2'" in ended["error"]
        assert "its autopilot is not heard yet" in ended["error"]
        assert "uav-1" not in ended["error"]
    finally:
        fleet.stop()


def test_a_stream_to_vehicles_that_do_not_hold_without_setpoints_is_refused_even_where_audits_only_report(
    service: tuple[TestClient, str],
) -> None:
    client, endpoint = service
    fleet = simulated(endpoint)
    try:
        for vehicle in fleet.fleet.vehicles.values():
            vehicle.autopilot.parameters["COM_OBL_RC_ACT"] = 0  # PX4's default
        order = {"plan_id": ready(client), "guidance": "stream", "launch": "manual"}
        refused = follow(client, client.post("/v1/operations", json=order).headers["Location"], "failed", "ready")
        assert refused["state"] == "failed"
        assert "COM_OBL_RC_ACT is 0, should be 5 (hold)" in refused["error"]
        assert not any(vehicle.autopilot.armed for vehicle in fleet.fleet.vehicles.values())
        forced = client.post("/v1/operations", json={**order, "force_stream": True}).headers["Location"]
        assert follow(client, forced, "failed", "ready")["state"] == "ready"
        assert client.post(f"{forced}:abort", json={"action": "hold"}).status_code == 200
    finally:
        fleet.stop()


def test_a_vehicle_that_stands_far_from_its_start_keeps_everybody_on_the_ground_by_name(
    service: tuple[TestClient, str],
) -> None:
    client, endpoint = service
    first, *others = MINIMAL.uavs
    east_m, north_m = first.start_m
    strayed = MINIMAL.with_changes(uavs=(first.model_copy(update={"start_m": (east_m + 50.0, north_m)}), *others))
    fleet = FleetThread(strayed, endpoint, SPEEDUP)
    try:
        path = client.post("/v1/operations", json={"plan_id": ready(client)}).headers["Location"]
        refused = follow(client, path, "failed", "flying")
        assert refused["state"] == "failed"
        assert f"'{first.id}': place is 50 m from its start, should be within 15 m" in refused["error"]
        assert others[0].id not in refused["error"]
        assert not any(vehicle.autopilot.armed for vehicle in fleet.fleet.vehicles.values())
    finally:
        fleet.stop()


def test_a_loss_in_flight_is_answered_and_the_survivor_lands(service: tuple[TestClient, str]) -> None:
    client, endpoint = service
    fleet = simulated(endpoint)
    try:
        answer = client.post("/v1/operations", json={"plan_id": ready(client, LONG)})
        path = answer.headers["Location"]
        assert client.post("/v1/operations", json={"plan_id": answer.json()["plan_id"]}).status_code == 409
        follow(client, path, "flying", "failed")
        fleet.inject(sim.Kill(2))
        ended = follow(client, path, "completed", "failed")
        assert ended["error"] is None
        assert ended["lost"] == ["uav-2"]
        assert [each["outcome"] for each in ended["recoveries"]] == ["flying"]
        assert ended["recoveries"][0]["vehicles"] == {"uav-1": None}
        assert len(ended["plan_ids"]) == 2
        again = client.get(f"/v1/plans/{ended['plan_id']}").json()
        assert again["cause"]["kind"] == "heartbeat_lost"
        assert again["cause"]["uav_ids"] == ["uav-2"]
        assert again["cause"]["silent_for_s"] >= PATIENT["heartbeat_lost_s"]
        landed = fleet.fleet.truth.happened("landed", 1)
        accepted = fleet.fleet.truth.happened("mission_accepted", 1)
        assert landed
        assert len(accepted) == 2
        kinds = [event["kind"] for event in events_of(client)]
        assert kinds.index("uav_lost") < kinds.index("recovery")
    finally:
        fleet.stop()


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
            order = {"plan_id": ready(client, LOW), "guidance": guidance, "at_end": at_end}
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
                assert f'skyfolio_slot_distance_metres_count{{uav="{uav}"}} {told}' in figures
                assert f'skyfolio_slot_lateness_seconds_count{{uav="{uav}"}} {told}' in figures
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


def test_the_area_is_on_board_as_geofence_before_take_off_and_who_takes_none_is_named(
    service: tuple[TestClient, str],
) -> None:
    client, endpoint = service
    fleet = simulated(endpoint)
    try:
        fleet.inject(sim.RejectMission(2, uploads=3))
        path = client.post("/v1/operations", json={"plan_id": ready(client)}).headers["Location"]
        begun = follow(client, path, "flying", "failed")
        assert begun["error"] is None
        truth = fleet.fleet.truth
        (accepted,) = truth.happened("fence_accepted")
        assert (accepted.system_id, len(accepted.detail["items"])) == (1, 4)
        assert accepted.t_s < truth.happened("takeoff", 1)[0].t_s
        assert_each_may_return_to_where_it_stood(client, fleet)
        log = events_of(client)
        told = {event["data"]["uav_id"]: event["data"] for event in log if event["kind"] == "geofence"}
        assert [told[uav]["level"] for uav in ("uav-1", "uav-2")] == ["ok", "warning"]
        assert "ERROR" in told["uav-2"]["error"]
        client.post(f"{path}:abort", json={"action": "land"})
    finally:
        fleet.stop()


def assert_each_may_return_to_where_it_stood(client: TestClient, fleet: FleetThread) -> None:
    """A rally point for each vehicle, at its own start and the plan's altitude, with an event."""
    for system_id, vehicle in fleet.fleet.vehicles.items():
        (taken,) = fleet.fleet.truth.happened("rally_accepted", system_id)
        (point,) = vehicle.autopilot.missions.plan(2).items
        assert taken.t_s < fleet.fleet.truth.happened("takeoff", system_id)[0].t_s
        assert (point.x / 1e7, point.y / 1e7) == pytest.approx(
            (vehicle.spec.home_lat_deg, vehicle.spec.home_lon_deg), abs=2e-6
        )
        assert point.z == MINIMAL.altitude_m
    log = events_of(client)
    levels = {event["data"]["uav_id"]: event["data"]["level"] for event in log if event["kind"] == "rally_point"}
    assert levels == {"uav-1": "ok", "uav-2": "ok"}


def test_an_aborted_operation_leaves_vehicles_holding(service: tuple[TestClient, str]) -> None:
    client, endpoint = service
    fleet = simulated(endpoint)
    try:
        path = client.post("/v1/operations", json={"plan_id": ready(client)}).headers["Location"]
        follow(client, path, "flying", "failed")
        answer = client.post(f"{path}:abort", json={"action": "hold"})
        assert answer.json()["state"] == "aborted"
        assert {vehicle.mode for vehicle in fleet.fleet.vehicles.values()} == {sim.Mode.HOLD}
        held = client.get(path).json()
        assert client.post(f"{path}:abort").json() == held  # the same again changes nothing
        assert client.post(f"{path}:pause").status_code == 409
    finally:
        fleet.stop()


def test_operations_that_cannot_be_are_refused(service: tuple[TestClient, str]) -> None:
    client, _ = service
    plan_id = ready(client)
    assert client.post("/v1/operations", json={"plan_id": "plan-0"}).status_code == 404
    assert client.get("/v1/operations/op-0").status_code == 404
    paper = client.post("/v1/plans", params={"wait_s": 60}, json=EXAMPLES["paper"]().model_dump(mode="json")).json()
    answer = client.post("/v1/operations", json={"plan_id": paper["id"]})
    assert answer.status_code == 422
    assert "'uav-3' is not registered" in answer.json()["detail"]
    crossing = EXAMPLES["minimal"]().with_changes(slots=20).model_dump(mode="json")
    for number, (start_m, end_m) in enumerate((((50.0, 50.0), (150.0, 60.0)), ((50.0, 60.0), (150.0, 50.0)))):
        crossing["uavs"][number] |= {"start_m": start_m, "end_m": end_m, "max_speed_mps": 10.0}
    made = client.post("/v1/plans", params={"wait_s": 60}, json=crossing).json()
    answer = client.post("/v1/operations", json={"plan_id": made["id"], "at_end": "return"})
    assert answer.status_code == 422, answer.text
    assert answer.json()["detail"].startswith("at_end: ")
    for weight in (-1.0, 1e10, "much"):
        answer = client.post("/v1/operations", json={"plan_id": plan_id, "disruption_weight": weight})
        assert answer.status_code == 422, answer.text
        assert [row["field"] for row in answer.json()["errors"]] == ["disruption_weight"]
    again = client.post(
        f"/v1/plans/{plan_id}/replans", params={"wait_s": 60}, json={"failed": ["uav-1"], "at_slot": 1}
    ).json()
    assert client.post("/v1/operations", json={"plan_id": again["id"]}).status_code == 422
    taken = client.post("/v1/fleet/vehicles", json={"uav_id": "uav-9", "system_id": 1})
    assert taken.status_code == 409
