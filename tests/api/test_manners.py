"""The manners of the API: keys that make repeating safe, pages, tags, progress, and what a restart keeps."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.client import ApiError, Client
from skyfolio.api.common.errors import NotFoundError
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.service import Service
from skyfolio.planner import EXAMPLES, Plan, plan, violations

LONG = EXAMPLES["paper"]().with_changes(slots=160)


@contextmanager
def service(url: str, **settings: Any) -> Iterator[tuple[TestClient, Client]]:
    with TestClient(create_app(Settings(database_url=url, warm_up=False, **settings))) as http:
        yield http, Client(http=http)


def test_a_restart_keeps_plans_and_keys_and_interrupts_what_was_unfinished(
    database_url: str, minimal: dict[str, Any]
) -> None:
    key = {"Idempotency-Key": "one"}
    other = {**minimal, "slots": 3}
    with service(database_url) as (http, client):
        answers = [http.post("/v1/plans", json=minimal, headers=key, params={"wait_s": wait}) for wait in (0, 60, 0)]
        assert len({answer.json()["id"] for answer in answers}) == 1
        assert answers[2].status_code == 200
        refused = http.post("/v1/plans", json=other, headers=key)
        assert refused.status_code == 422
        assert refused.json()["errors"][0]["field"] == "Idempotency-Key"
        assert http.post("/v1/plans", json=minimal, params={"wait_s": 60}).json()["id"] != answers[0].json()["id"]
        made = client.read_plan(answers[0].json()["id"])
        replanned = client.replan(made.id, failed=["uav-1"], at_slot=1)
        running = client.submit(LONG)
    with service(database_url) as (http, client):
        again = http.post("/v1/plans", json=minimal, headers=key)
        assert again.status_code == 200
        assert again.json()["id"] == made.id
        assert again.headers["Location"] == answers[0].headers["Location"]
        assert http.post("/v1/plans", json=other, headers=key).status_code == 422
        assert len(list(client.plans())) == 4
        assert client.read_plan(made.id) == made
        assert client.read_plan(replanned.id) == replanned
        left = client.read_plan(running.id)
        assert left.status == "interrupted"
        assert not isinstance(left, Plan)
        assert left.error
        kinds = [event.kind for event in client.events(follow=False)]
        assert kinds.count("service_started") == 2
        assert kinds.count("plan_ended") == 4
        assert http.get("/v1/plans", params={"status": "interrupted"}).json()["items"][0]["id"] == running.id


def test_lists_are_paged_and_every_plan_is_on_exactly_one_page(client: TestClient, minimal: dict[str, Any]) -> None:
    made = [client.post("/v1/plans", json=minimal, params={"wait_s": 60}).json()["id"] for _ in range(5)]
    seen: list[str] = []
    cursor = None
    while True:
        page = client.get("/v1/plans", params={"limit": 2} | ({"cursor": cursor} if cursor else {})).json()
        assert len(page["items"]) <= 2
        seen += [row["id"] for row in page["items"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert seen[:5] == made[::-1]
    assert len(seen) == len(set(seen))


def test_a_running_plan_tells_how_good_its_best_is_and_cancelling_gives_it(client: TestClient) -> None:
    location = client.post("/v1/plans", json=LONG.model_dump(mode="json")).headers["Location"]
    running: dict[str, Any] = {}
    while not running.get("progress"):
        running = client.get(location).json()
        assert running["status"] in {"queued", "running"}
    assert running["progress"]["iterations"] >= 1
    ended = client.post(f"{location}:cancel", params={"wait_s": 60})
    assert ended.status_code == 200
    best = Plan.model_validate(ended.json())
    assert best.status == "cancelled"
    assert violations(best) == []
    assert best.history[0].utility_bps <= best.history[-1].utility_bps


def test_a_deadline_ends_a_solve_with_the_best_so_far(client: TestClient) -> None:
    params = {"wait_s": 60, "deadline_s": 0.05}
    best = Plan.model_validate(client.post("/v1/plans", json=LONG.model_dump(mode="json"), params=params).json())
    assert best.status == "cancelled"
    assert violations(best) == []


async def test_ended_plans_are_forgotten_in_time(database_url: str) -> None:
    running = await Service.open(Settings(database_url=database_url, warm_up=False))
    try:
        made = await running.plans.adopt(plan(EXAMPLES["minimal"]()), fresh("plan"))
        assert await running.plans.forget_ended(before=0.0) == 0
        assert await running.plans.finished(made.id) == made
        assert await running.plans.forget_ended(before=1e12) == 1
        with pytest.raises(NotFoundError):
            await running.plans.record(made.id)
    finally:
        await running.close()


def test_the_n_minus_1_table_has_a_row_for_each_uav_and_is_made_once(client: TestClient, paper: dict[str, Any]) -> None:
    made = client.post("/v1/plans", json=paper, params={"wait_s": 60}).json()
    path = f"/v1/plans/{made['id']}/contingencies"
    table = client.get(path, params={"at_slot": 8, "wait_s": 60})
    assert table.status_code == 200
    rows = {row["uav_id"]: row for row in table.json()["rows"]}
    assert set(rows) == {"uav-1", "uav-2", "uav-3"}
    for row in rows.values():
        assert row["error"] is None
        assert 0 < row["mean_sum_rate_without_replan_bps"] < table.json()["mean_sum_rate_bps"]
        assert row["mean_sum_rate_bps"] > 0
        assert set(row["user_mean_rates_bps"]) == {f"user-{n}" for n in range(1, 10)}
    assert client.get(path, params={"at_slot": 8, "wait_s": 0}).json() == table.json()
    assert client.get(path, params={"at_slot": 20}).status_code == 422


def test_the_n_minus_1_table_tells_weights_apart_and_keeps_pins(client: TestClient, paper: dict[str, Any]) -> None:
    pins = {"uavs": ["uav-1"], "associations": {"user-1": "uav-3"}}
    made = client.post("/v1/plans", json={**paper, "pins": pins}, params={"wait_s": 60}).json()
    path = f"/v1/plans/{made['id']}/contingencies"
    tables = {
        weight: client.get(path, params={"at_slot": 8, "wait_s": 60, "disruption_weight": weight}).json()
        for weight in (0.0, 1e6)
    }
    assert client.get(path, params={"at_slot": 8}).json() == tables[0.0], "the setting's weight is 0"
    rows = {weight: {row["uav_id"]: row for row in table["rows"]} for weight, table in tables.items()}
    assert tables[1e6]["disruption_weight"] == 1e6
    for uav in ("uav-2", "uav-3"):
        free, dear = rows[0.0][uav], rows[1e6][uav]
        assert dear["disruption"]["path_changed_m"] < 1e-6 < free["disruption"]["path_changed_m"]
        assert dear["mean_sum_rate_bps"] <= free["mean_sum_rate_bps"]
        assert [pin["id"] for pin in free["dropped_pins"]] == (["user-1"] if uav == "uav-3" else [])
    assert [pin["id"] for pin in rows[0.0]["uav-1"]["dropped_pins"]] == ["uav-1"]
    refused = client.get(path, params={"disruption_weight": -1})
    assert refused.status_code == 422
    assert "disruption_weight" in refused.text


def test_the_only_uav_has_no_replacement_and_the_table_says_so(client: TestClient, minimal: dict[str, Any]) -> None:
    minimal["uavs"] = minimal["uavs"][:1]
    made = client.post("/v1/plans", json=minimal, params={"wait_s": 60}).json()
    [row] = client.get(f"/v1/plans/{made['id']}/contingencies", params={"wait_s": 60}).json()["rows"]
    assert "no UAV would be left" in row["error"]
    assert row["mean_sum_rate_without_replan_bps"] == 0


def test_the_client_raises_what_the_service_said(client: TestClient) -> None:
    typed = Client(http=client)
    with pytest.raises(ApiError, match="404 plan 'plan-0' does not exist") as refused:
        typed.read_plan("plan-0")
    assert refused.value.status == 404
    with pytest.raises(ApiError, match="404 operation"):
        typed.drill("op-0", "uav-1")


def test_health_solves_and_metrics_tell_of_it(client: TestClient, minimal: dict[str, Any]) -> None:
    health = client.get("/health").json()
    assert health["status"] == "ok"
    assert health["solve_ms"] > 0
    ready = client.get("/ready")
    checks = dict.fromkeys(("service", "database", "solver", "tasks", "heartbeat", "queue"), "ok")
    assert ready.json() == {"ready": True, "checks": checks}
    client.post("/v1/plans", json=minimal, params={"wait_s": 60})
    text = client.get("/metrics").text
    for name in (
        'skyfolio_solve_seconds_count{kind="plan"}',
        "skyfolio_solve_iterations_bucket",
        "skyfolio_losses_total",
        "skyfolio_upload_retries_total",
        "skyfolio_slip_metres",
        "skyfolio_replans_total",
        "skyfolio_replan_phase_seconds",
        "skyfolio_event_loop_lag_seconds_bucket",
        "process_cpu_seconds_total",
        "process_resident_memory_bytes",
        'skyfolio_request_seconds_count{method="POST",route="/v1/plans",status="200"}',
    ):
        assert name in text, name
