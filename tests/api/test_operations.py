"""Operations over HTTP: what is refused, how a loss is recovered from, what is on board before take-off."""

from typing import Any

import httpx2
import pytest

from skyfolio import sim
from skyfolio.mavlink_bridge import geodetic_to_east_north
from skyfolio.planner import EXAMPLES
from skyfolio.planner.scenario import RallyPoint
from tests.api.asking import planned
from tests.api.sky import Sky, sky

MINIMAL = EXAMPLES["minimal"]().with_changes(slots=8)
LONG = MINIMAL.with_changes(altitude_m=8.0, slots=16)


def follow(here: Sky, path: str, *states: str) -> dict[str, Any]:
    here.wait(lambda: here.http.get(path).json()["state"] in states, f"not {states}")
    operation: dict[str, Any] = here.http.get(path).json()
    return operation


def test_a_vehicle_that_never_answers_fails_the_upload_by_name() -> None:
    with sky(MINIMAL, absent=(2,)) as here:
        client = here.http
        plan_id = planned(client, MINIMAL)
        answer = client.post("/v1/operations", json={"plan_id": plan_id})
        assert answer.status_code == 202
        ended = follow(here, answer.headers["Location"], "failed", "completed")
        assert ended["state"] == "failed"
        assert "upload failed for 'uav-2'" in ended["error"]
        assert "its autopilot is not heard yet" in ended["error"]
        assert "uav-1" not in ended["error"]


def test_a_stream_to_vehicles_that_do_not_hold_without_setpoints_is_refused_even_where_audits_only_report() -> None:
    with sky(MINIMAL) as here:
        client, fleet = here.http, here.fleet
        for vehicle in fleet.vehicles.values():
            vehicle.autopilot.parameters["COM_OBL_RC_ACT"] = 0  # PX4's default
        order = {"plan_id": planned(client, MINIMAL), "guidance": "stream", "launch": "manual"}
        refused = follow(here, client.post("/v1/operations", json=order).headers["Location"], "failed", "ready")
        assert refused["state"] == "failed"
        assert "COM_OBL_RC_ACT is 0, should be 5 (hold)" in refused["error"]
        assert not any(vehicle.autopilot.armed for vehicle in fleet.vehicles.values())
        forced = client.post("/v1/operations", json={**order, "force_stream": True}).headers["Location"]
        assert follow(here, forced, "failed", "ready")["state"] == "ready"
        assert client.post(f"{forced}:abort", json={"action": "hold"}).status_code == 200


def test_a_vehicle_that_stands_far_from_its_start_keeps_everybody_on_the_ground_by_name() -> None:
    first, *others = MINIMAL.uavs
    east_m, north_m = first.start_m
    strayed = MINIMAL.with_changes(uavs=(first.model_copy(update={"start_m": (east_m + 50.0, north_m)}), *others))
    with sky(strayed) as here:
        client, fleet = here.http, here.fleet
        path = client.post("/v1/operations", json={"plan_id": planned(client, MINIMAL)}).headers["Location"]
        refused = follow(here, path, "failed", "flying")
        assert refused["state"] == "failed"
        assert f"'{first.id}': place is 50 m from its start, should be within 15 m" in refused["error"]
        assert others[0].id not in refused["error"]
        assert not any(vehicle.autopilot.armed for vehicle in fleet.vehicles.values())


def test_a_loss_in_flight_is_answered_and_the_survivor_lands() -> None:
    with sky(MINIMAL) as here:
        client, fleet = here.http, here.fleet
        answer = client.post("/v1/operations", json={"plan_id": planned(client, LONG)})
        path = answer.headers["Location"]
        assert client.post("/v1/operations", json={"plan_id": answer.json()["plan_id"]}).status_code == 409
        follow(here, path, "flying", "failed")
        fleet.inject(sim.Kill(2))
        ended = follow(here, path, "completed", "failed")
        assert ended["error"] is None
        assert ended["lost"] == ["uav-2"]
        assert [each["outcome"] for each in ended["recoveries"]] == ["flying"]
        assert ended["recoveries"][0]["vehicles"] == {"uav-1": None}
        assert len(ended["plan_ids"]) == 2
        again = client.get(f"/v1/plans/{ended['plan_id']}").json()
        assert again["cause"]["kind"] == "heartbeat_lost"
        assert again["cause"]["uav_ids"] == ["uav-2"]
        assert again["cause"]["silent_for_s"] >= 5.0
        landed = fleet.truth.happened("landed", 1)
        accepted = fleet.truth.happened("mission_accepted", 1)
        assert landed
        assert len(accepted) == 2
        kinds = [event["kind"] for event in here.events()]
        assert kinds.index("uav_lost") < kinds.index("recovery")


def test_the_area_is_on_board_as_geofence_before_take_off_and_who_takes_none_is_named() -> None:
    with sky(MINIMAL) as here:
        client, fleet = here.http, here.fleet
        fleet.inject(sim.RejectMission(2, uploads=3))
        path = client.post("/v1/operations", json={"plan_id": planned(client, MINIMAL)}).headers["Location"]
        begun = follow(here, path, "flying", "failed")
        assert begun["error"] is None
        truth = fleet.truth
        (accepted,) = truth.happened("fence_accepted")
        assert (accepted.system_id, len(accepted.detail["items"])) == (1, 4)
        assert accepted.t_s < truth.happened("takeoff", 1)[0].t_s
        assert_each_may_return_to_where_it_stood(here)
        log = here.events()
        told = {event["data"]["uav_id"]: event["data"] for event in log if event["kind"] == "geofence"}
        assert [told[uav]["level"] for uav in ("uav-1", "uav-2")] == ["ok", "warning"]
        assert "ERROR" in told["uav-2"]["error"]
        client.post(f"{path}:abort", json={"action": "land"})


def assert_each_may_return_to_where_it_stood(here: Sky) -> None:
    """A rally point for each vehicle, at its own start and the plan's altitude, with an event."""
    for system_id, vehicle in here.fleet.vehicles.items():
        (taken,) = here.fleet.truth.happened("rally_accepted", system_id)
        (point,) = vehicle.autopilot.missions.plan(2).items
        assert taken.t_s < here.fleet.truth.happened("takeoff", system_id)[0].t_s
        assert (point.x / 1e7, point.y / 1e7) == pytest.approx(
            (vehicle.spec.home_lat_deg, vehicle.spec.home_lon_deg), abs=2e-6
        )
        assert point.z == MINIMAL.altitude_m
    log = here.events()
    levels = {event["data"]["uav_id"]: event["data"]["level"] for event in log if event["kind"] == "rally_point"}
    assert levels == {"uav-1": "ok", "uav-2": "ok"}


def test_the_rally_points_of_the_scenario_are_on_board_beside_where_each_vehicle_stood() -> None:
    rally = (300.0, 20.0)
    scenario = MINIMAL.with_changes(rally_points=(RallyPoint(position_m=rally),))
    with sky(scenario) as here:
        path = here.http.post("/v1/operations", json={"plan_id": planned(here.http, scenario)}).headers["Location"]
        follow(here, path, "flying", "failed")
        for system_id, vehicle in here.fleet.vehicles.items():
            places = [
                geodetic_to_east_north(scenario.origin, item.x / 1e7, item.y / 1e7)
                for item in vehicle.autopilot.missions.plan(2).items
            ]
            assert places[0] == pytest.approx(scenario.uavs[system_id - 1].start_m, abs=0.2)
            assert places[1:] == [pytest.approx(rally, abs=0.05)]
        here.http.post(f"{path}:abort", json={"action": "land"})


def test_an_aborted_operation_leaves_vehicles_holding() -> None:
    with sky(MINIMAL) as here:
        client, fleet = here.http, here.fleet
        path = client.post("/v1/operations", json={"plan_id": planned(client, MINIMAL)}).headers["Location"]
        follow(here, path, "flying", "failed")
        answer = client.post(f"{path}:abort", json={"action": "hold"})
        assert answer.json()["state"] == "aborted"
        assert {vehicle.mode for vehicle in fleet.vehicles.values()} == {sim.Mode.HOLD}
        held = client.get(path).json()
        assert client.post(f"{path}:abort").json() == held  # the same again changes nothing
        assert client.post(f"{path}:pause").status_code == 409


def test_operations_that_cannot_be_are_refused() -> None:
    with sky(MINIMAL) as here:
        assert_refused(here.http)


def assert_refused(client: httpx2.Client) -> None:
    plan_id = planned(client, MINIMAL)
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
