"""Plans and replans over HTTP."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fastapi.testclient import TestClient

from skyfolio.api.client import Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.routes.examples import PLAN_EXAMPLES, REPLAN_EXAMPLES
from skyfolio.api.plans.plan_records import UnfinishedPlan
from skyfolio.mavlink_bridge import Autopilot, compile_mission, from_qgc_plan, from_waypoints
from skyfolio.planner import EXAMPLES, Changes, Pins, Plan, Uav, violations
from skyfolio.planner.layouts import scattered

CROWD = [{"id": f"guest-{k}", "position_m": [1.0, 1.0]} for k in range(5000)]
LONG = {"starts": 64}
"""From so many starts, a scenario that takes a second takes ten."""


def planned(client: TestClient, scenario: dict[str, Any]) -> dict[str, Any]:
    answer = client.post("/v1/plans", params={"wait_s": 60}, json=scenario)
    assert answer.status_code == 200, answer.text
    made: dict[str, Any] = answer.json()
    return made


def test_a_plan_waited_for_is_a_feasible_plan_of_the_contract_s_shape(
    client: TestClient, minimal: dict[str, Any]
) -> None:
    made = planned(client, minimal)
    plan = Plan.model_validate(made)
    assert violations(plan) == []
    assert plan.status == "succeeded"
    assert plan.solve_ms is not None
    assert plan.solve_ms > 0
    assert set(plan.trajectories_m) == {"uav-1", "uav-2"}
    assert plan.scenario == EXAMPLES["minimal"]()
    assert plan.summary.utility_bps <= plan.summary.upper_bound_bps


def test_a_plan_not_waited_for_is_accepted_and_found_at_its_location(client: TestClient) -> None:
    long = EXAMPLES["paper"]().with_changes(slots=80).model_dump(mode="json")
    answer = client.post("/v1/plans", params=LONG, json=long)
    assert answer.status_code == 202
    assert answer.json()["status"] in {"queued", "running"}
    assert answer.headers["Retry-After"]
    found = client.get(answer.headers["Location"], params={"wait_s": 60})
    assert found.status_code == 200
    assert found.json()["status"] == "succeeded"
    assert found.json()["id"] == answer.json()["id"]


def test_a_replan_has_parent_cause_and_survivors_only(client: TestClient, paper: dict[str, Any]) -> None:
    made = planned(client, paper)
    body = {"failed": ["uav-3"], "at_slot": 12, "positions_m": {"uav-1": [120.0, 370.0]}}
    answer = client.post(f"/v1/plans/{made['id']}/replans", params={"wait_s": 60}, json=body)
    assert answer.status_code == 200, answer.text
    again = Plan.model_validate(answer.json())
    assert violations(again) == []
    assert again.parent == made["id"]
    assert again.revision == 2
    assert again.cause.uav_ids == ("uav-3",)
    assert again.first_slot == 12
    assert set(again.trajectories_m) == {"uav-1", "uav-2"}
    assert again.trajectories_m["uav-1"][0] == (120.0, 370.0)
    assert again.trajectories_m["uav-2"][0] == tuple(made["trajectories_m"]["uav-2"][12])
    assert again.scenario.slots == 8
    assert again.achieved_rates_bps["user-1"] == pytest.approx(made["user_rates_bps"]["user-1"][:12])


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"failed": ["uav-9"], "at_slot": 2}, "failed"),
        ({"failed": ["uav-1", "uav-2"], "at_slot": 2}, "failed"),
        ({"failed": ["uav-1"], "at_slot": 4}, "at_slot"),
        ({"failed": ["uav-1"], "at_slot": -1}, "at_slot"),
        ({"failed": ["uav-1"], "at_slot": 1, "positions_m": {"uav-7": [0, 0]}}, "positions_m"),
        ({"failed": [], "at_slot": 1, "positions_m": {"uav-1": [50, 50], "uav-2": [51, 50]}}, "positions_m"),
        (
            {"failed": ["uav-1"], "at_slot": 1, "achieved_rates_bps": {"user-1": [1.0, 2.0]}},
            "achieved_rates_bps.user-1",
        ),
        ({"failed": ["uav-1"], "at_slot": 1, "achieved_rates_bps": {"user-1": [-1.0]}}, "achieved_rates_bps.user-1"),
        ({"failed": ["uav-1"], "at_slot": 1, "achieved_rates_bps": {"nobody": [1.0]}}, "achieved_rates_bps"),
        ({"failed": ["uav-1"], "at_slot": 1, "surprise": True}, "surprise"),
        ({"at_slot": 1, "users_left": ["nobody"]}, "users_left"),
        ({"at_slot": 1, "users_left": ["user-1", "user-2", "user-3", "user-4"]}, "users_left"),
        ({"at_slot": 1, "users_joined": [{"id": "user-1", "position_m": [1.0, 1.0]}]}, "users_joined"),
        ({"at_slot": 1, "users_joined": [{"id": "new", "position_m": [1.0, 1.0]}] * 2}, "users_joined"),
        ({"at_slot": 1, "users_joined": [{"id": "new", "position_m": ["east", 1.0]}]}, "users_joined.0.position_m.0"),
        ({"at_slot": 1, "users_joined": CROWD}, "users"),
        ({"at_slot": 1, "returned": [{"id": "uav-1", "start_m": [50.0, 50.0]}]}, "returned"),
        ({"at_slot": 1, "returned": [{"id": "uav-3", "start_m": [999.0, 50.0]}]}, "returned"),
        ({"at_slot": 0, "returned": [{"id": "uav-3", "start_m": [51.0, 50.0]}]}, "returned"),
        ({"at_slot": 1, "bandwidth_hz": {"uav-9": 5000.0}}, "bandwidth_hz"),
        ({"at_slot": 1, "bandwidth_hz": {"uav-1": -1.0}}, "bandwidth_hz.uav-1"),
        ({"at_slot": 1, "utility": {"kind": "sum", "mu_per_kbps": 1.0}}, "utility.mu_per_kbps"),
        ({"at_slot": 1, "utility": {"kind": "applause"}}, "utility.kind"),
        ({"at_slot": 1, "slots": 0}, "slots"),
        ({"at_slot": 1, "leaves_at": {"uav-1": 1}}, "leaves_at.uav-1"),
        ({"at_slot": 1, "leaves_at": {"uav-9": 3}}, "leaves_at"),
        ({"at_slot": 1, "ends_m": {"uav-1": [1e5, 0.0]}}, "ends_m"),
    ],
)
def test_a_replan_that_makes_no_sense_is_refused_by_field(
    client: TestClient, minimal: dict[str, Any], body: dict[str, Any], field: str
) -> None:
    made = planned(client, minimal)
    answer = client.post(f"/v1/plans/{made['id']}/replans", json=body)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert [row["field"] for row in answer.json()["errors"]] == [field]


def test_a_plan_is_extended_and_a_uav_told_when_and_where_to_leave_it(
    client: TestClient, paper: dict[str, Any]
) -> None:
    made = planned(client, paper)
    pad = made["trajectories_m"]["uav-1"][0]
    body = {"at_slot": 10, "slots": 20, "leaves_at": {"uav-1": 25}, "ends_m": {"uav-1": pad}}
    answer = client.post(f"/v1/plans/{made['id']}/replans", params={"wait_s": 60}, json=body)
    assert answer.status_code == 200, answer.text
    again = Plan.model_validate(answer.json())
    assert violations(again) == []
    assert (again.first_slot, again.scenario.slots) == (10, 20)
    assert again.scenario.uav("uav-1").leaves_at_slot == 15
    assert again.trajectories_m["uav-1"][14] == pytest.approx(tuple(pad))


def test_a_replan_takes_in_users_bands_and_another_utility_at_once(client: TestClient, paper: dict[str, Any]) -> None:
    made = planned(client, paper)
    body = {
        "at_slot": 10,
        "failed": ["uav-2"],
        "users_left": ["user-1"],
        "users_joined": [{"id": "newcomer", "position_m": [300.0, 300.0]}],
        "utility": {"kind": "pooled", "mu_per_kbps": -0.3},
        "bandwidth_hz": {"uav-1": 20_000.0},
    }
    answer = client.post(f"/v1/plans/{made['id']}/replans", params={"wait_s": 60}, json=body)
    assert answer.status_code == 200, answer.text
    again = Plan.model_validate(answer.json())
    assert violations(again) == []
    assert again.cause.uav_ids == ("uav-2",)
    assert again.scenario.uav_ids == ("uav-1", "uav-3")
    assert again.scenario.user_ids == (*(f"user-{k}" for k in range(2, 10)), "newcomer")
    assert again.scenario.utility.kind == "pooled"
    assert again.scenario.uav("uav-1").bandwidth_hz == 20_000.0
    assert again.achieved_rates_bps["newcomer"] == []
    assert "user-1" not in again.achieved_rates_bps


def test_a_uav_that_comes_back_is_planned_for_from_where_it_is(client: TestClient) -> None:
    service = Client(http=client)
    made = service.plan(EXAMPLES["paper"]())
    without = service.replan(made.id, failed=["uav-3"], at_slot=8)
    assert (without.cause.kind, without.cause.uav_ids) == ("requested", ("uav-3",))
    back = Uav(id="uav-3", start_m=(260.0, 130.0))
    again = service.replan(without.id, at_slot=12, changes=Changes(returned=(back,)))
    assert again.scenario.uav_ids == ("uav-1", "uav-2", "uav-3")
    assert again.trajectories_m["uav-3"][0] == (260.0, 130.0)
    assert (again.cause.kind, again.cause.uav_ids) == ("uav_returned", ("uav-3",))
    assert service.replan(made.id, at_slot=8, changes=Changes(users_left=("user-1",))).cause.kind == "users_changed"


@pytest.mark.parametrize("example", REPLAN_EXAMPLES["requestBody"]["content"]["application/json"]["examples"].values())
def test_every_example_of_a_replan_is_one(client: TestClient, minimal: dict[str, Any], example: dict[str, Any]) -> None:
    made = planned(client, minimal)
    if "returned" in example["value"]:
        path = f"/v1/plans/{made['id']}/replans"
        made = client.post(path, params={"wait_s": 60}, json={"failed": ["uav-2"], "at_slot": 1}).json()
    answer = client.post(f"/v1/plans/{made['id']}/replans", params={"wait_s": 60}, json=example["value"])
    assert answer.status_code == 200, answer.text


def test_every_example_of_a_plan_is_one(client: TestClient) -> None:
    for example in PLAN_EXAMPLES["requestBody"]["content"]["application/json"]["examples"].values():
        made = Plan.model_validate(planned(client, example["value"]))
        assert violations(made) == []


def test_a_plan_keeps_the_pins_of_its_request_and_a_replan_those_of_its_own(
    client: TestClient, minimal: dict[str, Any]
) -> None:
    pins = {"uavs": ["uav-1"], "associations": {"user-4": "uav-1"}}
    made = Plan.model_validate(planned(client, {**minimal, "pins": pins}))
    start = EXAMPLES["minimal"]().uav("uav-1").start_m
    assert made.trajectories_m["uav-1"] == [start] * 4
    assert set(made.association["user-4"]) == {"uav-1"}
    assert list(made.pins.paths_m) == ["uav-1"]
    path = [list(point) for point in made.trajectories_m["uav-2"][1:]]
    body = {"at_slot": 1, "users_left": ["user-1"], "pins": {"paths_m": {"uav-2": path}}, "disruption_weight": 1e6}
    answer = client.post(f"/v1/plans/{made.id}/replans", params={"wait_s": 60}, json=body)
    assert answer.status_code == 200, answer.text
    again = Plan.model_validate(answer.json())
    assert again.trajectories_m["uav-2"] == made.trajectories_m["uav-2"][1:]
    assert list(again.pins.paths_m) == ["uav-2"]
    assert again.disruption is not None
    assert again.disruption.weight_kbps == 1e6
    assert again.disruption.users_changed == 0
    assert again.disruption.path_changed_m < 1e-9
    free = client.post(
        f"/v1/plans/{made.id}/replans", params={"wait_s": 60}, json={"at_slot": 1, "users_left": ["user-1"]}
    ).json()
    assert free["pins"] == {"paths_m": {}, "uavs": [], "associations": {}}
    assert free["disruption"]["price_bps"] == 0.0
    assert free["summary"]["utility_bps"] >= again.summary.utility_bps


def test_a_replan_keeps_the_pins_of_the_plan_before_where_it_is_asked_to_and_tells_which_it_cannot(
    client: TestClient, minimal: dict[str, Any]
) -> None:
    pins = {"uavs": ["uav-1", "uav-2"], "associations": {"user-4": "uav-1", "user-1": "uav-2"}}
    made = planned(client, {**minimal, "pins": pins})
    body = {"at_slot": 1, "failed": ["uav-2"], "keep_pins": True}
    answer = client.post(f"/v1/plans/{made['id']}/replans", params={"wait_s": 60}, json=body)
    assert answer.status_code == 200, answer.text
    again = answer.json()
    assert list(again["pins"]["paths_m"]) == ["uav-1"]
    assert again["pins"]["associations"] == {"user-4": "uav-1"}
    assert again["dropped_pins"] == [
        {"kind": "path", "id": "uav-2", "slots": 3, "reason": "'uav-2' is lost"},
        {"kind": "association", "id": "user-1", "slots": 3, "reason": "'uav-2' is lost"},
    ]


def test_a_plan_without_a_result_shows_what_it_was_asked_to_keep_also_after_a_restart(
    client: TestClient, tmp_path: Path
) -> None:
    long = scattered(12, 36, 200, seed=3)
    pins = {"uavs": [long.uav_ids[0]], "associations": {long.user_ids[1]: long.uav_ids[2]}}
    body = {**long.model_dump(mode="json"), "pins": pins}
    location = client.post("/v1/plans", params=LONG, json=body).headers["Location"]
    seen = UnfinishedPlan.model_validate_json(client.get(location).content)
    assert seen.pins == Pins.model_validate(pins)
    ended = Plan.model_validate_json(client.post(f"{location}:cancel", params={"wait_s": 60}).content)
    assert list(ended.pins.paths_m) == [long.uav_ids[0]]
    settings = Settings(database_url=f"sqlite+aiosqlite:///{tmp_path / 'kept.db'}", warm_up=False)
    with TestClient(create_app(settings)) as first:
        location = first.post("/v1/plans", params=LONG, json=body).headers["Location"]
    with TestClient(create_app(settings)) as second:
        left = UnfinishedPlan.model_validate_json(second.get(location).content)
        assert (left.status, left.pins) == ("interrupted", Pins.model_validate(pins))


def test_a_replan_without_a_result_shows_its_weight_and_whether_pins_are_kept(client: TestClient) -> None:
    made = planned(client, EXAMPLES["minimal"]().model_dump(mode="json"))
    blocker = client.post("/v1/plans", json=scattered(12, 36, 200, seed=4).model_dump(mode="json"), params=LONG)
    body = {"at_slot": 1, "keep_pins": True, "disruption_weight": 2.5}
    seen = client.post(f"/v1/plans/{made['id']}/replans", json=body).json()
    assert (seen["status"], seen["keep_pins"], seen["disruption_weight"]) == ("queued", True, 2.5)
    client.post(f"{blocker.headers['Location']}:cancel", params={"wait_s": 60})


@pytest.mark.parametrize(
    ("pins", "field"),
    [
        ({"uavs": ["uav-9"]}, "pins.uavs"),
        ({"paths_m": {"uav-1": [[0.0, 0.0]]}}, "pins.paths_m.uav-1"),
        ({"associations": {"user-1": "uav-9"}}, "pins.associations.user-1"),
        ({"areas": []}, "pins.areas"),
    ],
)
def test_pins_that_cannot_be_kept_are_refused_by_field(
    client: TestClient, minimal: dict[str, Any], pins: dict[str, Any], field: str
) -> None:
    made = planned(client, minimal)
    for answer in (
        client.post("/v1/plans", json={**minimal, "pins": pins}),
        client.post(f"/v1/plans/{made['id']}/replans", json={"at_slot": 1, "pins": pins}),
    ):
        assert answer.status_code == 422, answer.text
        assert field in answer.text


@pytest.mark.parametrize("weight", [-1.0, 1e10, "much"])
def test_a_disruption_weight_out_of_range_is_refused_by_field(
    client: TestClient, minimal: dict[str, Any], weight: object
) -> None:
    made = planned(client, minimal)
    body = {"at_slot": 1, "failed": ["uav-2"], "disruption_weight": weight}
    answer = client.post(f"/v1/plans/{made['id']}/replans", json=body)
    assert answer.status_code == 422
    assert "disruption_weight" in answer.text


def test_one_idempotency_key_with_other_pins_is_another_request(client: TestClient, minimal: dict[str, Any]) -> None:
    headers = {"Idempotency-Key": "one-key-other-pins"}
    first = client.post("/v1/plans", headers=headers, json={**minimal, "pins": {"uavs": ["uav-1"]}})
    assert first.status_code in {200, 202}
    again = client.post("/v1/plans", headers=headers, json={**minimal, "pins": {"uavs": ["uav-2"]}})
    assert again.status_code == 422
    assert "Idempotency-Key" in again.text


def test_the_client_sends_pins_and_weight(client: TestClient) -> None:
    api = Client(http=client)
    made = api.plan(EXAMPLES["minimal"](), pins=Pins(uavs=("uav-2",)))
    assert list(made.pins.paths_m) == ["uav-2"]
    changes = Changes(users_left=("user-1",))
    again = api.replan(made.id, at_slot=1, changes=changes, pins=Pins(uavs=("uav-1",)), disruption_weight=2.0)
    assert list(again.pins.paths_m) == ["uav-1"]
    assert again.disruption is not None
    assert again.disruption.weight_kbps == 2.0


def test_a_cancelled_plan_ends_with_the_best_it_had(client: TestClient) -> None:
    scenario = EXAMPLES["paper"]().with_changes(slots=400).model_dump(mode="json")
    answer = client.post("/v1/plans", json=scenario)
    location = answer.headers["Location"]
    assert client.post(f"{location}:cancel").status_code == 202
    ended = client.get(location, params={"wait_s": 60}).json()
    assert ended["status"] == "cancelled"
    assert violations(Plan.model_validate(ended)) == []
    assert client.post(f"{location}:cancel").json()["status"] == "cancelled"


def test_a_running_plan_shows_its_best_so_far_which_cancelling_returns_or_betters(client: TestClient) -> None:
    scenario = scattered(12, 36, 200, seed=3)
    location = client.post("/v1/plans", params=LONG, json=scenario.model_dump(mode="json")).headers["Location"]
    while (seen := client.get(location, params={"wait_s": 0.05})).status_code == 202 and seen.json()["best"] is None:
        pass
    assert seen.status_code == 202
    view = UnfinishedPlan.model_validate_json(seen.content)
    assert view.best is not None
    assert view.progress is not None
    assert view.best.status == view.status == "running"
    assert (view.best.id, view.best.scenario) == (view.id, scenario)
    assert violations(view.best) == []
    assert 0 < view.best.summary.utility_bps <= view.progress.utility_bps * (1 + 1e-9)
    ended = Plan.model_validate_json(client.post(f"{location}:cancel", params={"wait_s": 60}).content)
    assert ended.status == "cancelled"
    assert violations(ended) == []
    assert ended.summary.utility_bps >= view.best.summary.utility_bps * (1 - 1e-9)
    assert "best" not in client.get(location).json()


def test_a_plan_that_waits_has_no_best_and_never_that_of_the_job_before(client: TestClient) -> None:
    long = scattered(12, 36, 200, seed=3).model_dump(mode="json")
    running, waiting = (client.post("/v1/plans", params=LONG, json=long).headers["Location"] for _ in range(2))
    while client.get(running, params={"wait_s": 0.05}).json()["best"] is None:
        pass
    seen = client.get(waiting).json()
    assert (seen["status"], seen["best"], seen["progress"]) == ("queued", None, None)
    client.post(f"{running}:cancel", params={"wait_s": 60})
    seen = client.get(waiting, params={"wait_s": 0.01}).json()
    assert seen["best"] is None or seen["best"]["id"] == seen["id"]
    assert client.post(f"{waiting}:cancel", params={"wait_s": 60}).json()["status"] == "cancelled"


def test_more_solves_than_the_queue_holds_are_told_to_come_back(client: TestClient) -> None:
    scenario = EXAMPLES["paper"]().with_changes(slots=400).model_dump(mode="json")
    answers = [client.post("/v1/plans", json=scenario) for _ in range(5)]
    assert [answer.status_code for answer in answers] == [202, 202, 202, 202, 503]
    assert answers[-1].headers["Retry-After"]
    for answer in answers[:-1]:
        client.post(f"{answer.headers['Location']}:cancel")
    for answer in answers[:-1]:
        assert client.get(answer.headers["Location"], params={"wait_s": 60}).json()["status"] == "cancelled"


def test_missions_for_ardupilot_begin_with_home_in_every_format(client: TestClient, minimal: dict[str, Any]) -> None:
    made = planned(client, minimal)
    path = f"/v1/plans/{made['id']}/missions"

    def asked(**params: str) -> httpx2.Response:
        return client.get(path, params={"autopilot": "ardupilot", **params})

    plan = Plan.model_validate(made)
    rows, file = asked().json(), asked(format="plan", uav_id="uav-2").json()
    for uav in ("uav-1", "uav-2"):
        assert rows[uav] == [asdict(item) for item in compile_mission(plan, uav, autopilot=Autopilot.ARDUPILOT).items]
        assert [item["command"] for item in rows[uav][:2]] == [16, 22]  # home, then NAV_TAKEOFF
    assert file["mission"]["firmwareType"] == 3
    assert len(from_qgc_plan(file)) == len(rows["uav-2"])
    assert len(from_waypoints(asked(format="waypoints", uav_id="uav-1").text)) == len(rows["uav-1"])
    assert asked(autopilot="parrot").status_code == 422


def test_a_plan_nobody_made_is_not_found(client: TestClient) -> None:
    for answer in (client.get("/v1/plans/plan-0"), client.post("/v1/plans/plan-0:cancel")):
        assert answer.status_code == 404
        assert answer.json()["type"] == "urn:skyfolio:problem:not-found"


def test_missions_come_as_json_for_all_and_as_files_for_one(client: TestClient, minimal: dict[str, Any]) -> None:
    made = planned(client, minimal)
    path = f"/v1/plans/{made['id']}/missions"
    every = client.get(path).json()
    assert set(every) == {"uav-1", "uav-2"}
    assert every["uav-1"][0]["command"] == 22
    file = client.get(path, params={"format": "plan", "uav_id": "uav-2"}).json()
    assert file["fileType"] == "Plan"
    assert [len(polygon["polygon"]) for polygon in file["geoFence"]["polygons"]] == [4]  # as the service uploads it
    assert len(file["rallyPoints"]["points"]) == 1
    text = client.get(path, params={"format": "waypoints", "uav_id": "uav-1"})
    assert text.headers["content-type"].startswith("text/plain")
    assert text.text.startswith("QGC WPL 110\n")
    for params in (
        {"format": "plan"},
        {"format": "waypoints", "uav_id": "uav-9"},
        {"format": "plan", "uav_id": "uav-9", "autopilot": "ardupilot"},
    ):
        answer = client.get(path, params=params)
        assert answer.status_code == 422
        assert answer.json()["errors"][0]["field"] == "uav_id"
