"""Scenarios from files and plans as files, over REST, by the client and on the command line."""

import base64
import json
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.cli import main as cli
from skyfolio.api.client.service_client import Client
from skyfolio.planner import EXAMPLES, Plan, Scenario
from tests.places.test_writing import flown, town

USERS = "id,lat_deg,lon_deg\nkiosk,47.3981,8.5463\n"


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["skyfolio", *arguments])
    try:
        cli.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def test_files_become_a_scenario_that_can_be_planned(client: TestClient, minimal: dict[str, Any]) -> None:
    body = {"files": [{"name": "users.csv", "content": USERS}], "base": minimal, "settings": {"slots": 3}}
    answer = client.post("/v1/scenarios:import", json=body)
    assert answer.status_code == 200, answer.text
    scenario = answer.json()["scenario"]
    assert [user["id"] for user in scenario["users"]] == ["kiosk"]
    assert scenario["slots"] == 3
    assert "base: kept area_m, no_fly, origin, uavs of the base scenario" in answer.json()["notes"]
    assert client.post("/v1/scenarios:validate", json=scenario).status_code == 200


def test_a_scenario_in_degrees_alone_is_valid(client: TestClient, minimal: dict[str, Any]) -> None:
    minimal["users"] = [{"id": "kiosk", "position_deg": {"lat": 47.3981, "lon": 8.5463}}]
    assert client.post("/v1/scenarios:validate", json=minimal).json()["users"] == 1
    minimal["users"] = [{"id": "kiosk", "position_deg": {"lat": 147.3981, "lon": 8.5463}}]
    [row] = client.post("/v1/scenarios:validate", json=minimal).json()["errors"]
    assert row["field"] == "users.0.position_deg.lat"


def test_what_is_wrong_in_a_file_is_told_by_row_and_column(client: TestClient, minimal: dict[str, Any]) -> None:
    content = base64.b64encode("id;lat;lon\nZürich;47,39;8,54\n".encode("cp1252")).decode()
    file = {"name": "users.csv", "content_base64": content}
    answer = client.post("/v1/scenarios:import", json={"files": [file], "base": minimal})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["rule"] == "encoding"
    named = {**file, "encoding": "windows-1252"}
    [lat, lon] = client.post("/v1/scenarios:import", json={"files": [named], "base": minimal}).json()["errors"]
    assert (lat["file"], lat["row"], lat["column"], lat["rule"]) == ("users.csv", "row 2", "lat", "decimal_comma")
    assert lon["column"] == "lon"


def test_what_is_larger_than_the_service_plans_is_refused(client: TestClient, minimal: dict[str, Any]) -> None:
    rows = "".join(f"u{n},47.3981,8.5463\n" for n in range(5001))
    file = {"name": "users.csv", "content": "id,lat,lon\n" + rows}
    answer = client.post("/v1/scenarios:import", json={"files": [file], "base": minimal})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "users"


def test_a_plan_is_exported_in_each_format_and_the_client_reads_it_back(client: TestClient) -> None:
    service = Client(http=client)
    plan = service.plan(EXAMPLES["minimal"]())
    for form, kind in (("geojson", "application/geo+json"), ("kml", "google-earth"), ("csv", "text/csv")):
        answer = client.get(f"/v1/plans/{plan.id}/export", params={"format": form})
        assert kind in answer.headers["content-type"]
    text = service.export(plan.id)
    imported = service.import_files({"plan.geojson": text.encode()})
    assert [uav.start_m for uav in imported.uavs] == [uav.start_m for uav in plan.scenario.uavs]
    assert client.get("/v1/plans/none/export").status_code == 404


def test_the_command_line_imports_and_exports(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    plan, users, scenario = tmp_path / "plan.json", tmp_path / "places.csv", tmp_path / "scenario.json"
    plan.write_text(flown().model_dump_json())
    users.write_text(USERS)
    assert run(monkeypatch, "export", str(plan), "--format", "geojson", "--out", str(tmp_path / "plan.geojson")) == 0
    arguments = [str(tmp_path / "plan.geojson"), "--users", str(users), "--slots", "5", "--out", str(scenario)]
    assert run(monkeypatch, "import", *arguments) == 0
    made = Scenario.model_validate_json(scenario.read_text())
    assert (made.user_ids, made.slots, made.origin) == (("user-1", "user-2", "kiosk"), 5, town().origin)
    assert run(monkeypatch, "export", str(scenario), "--format", "csv") == 0
    assert "user,kiosk,POINT (8.5463 47.3981)" in capsys.readouterr().out
    assert run(monkeypatch, "import", str(users), "--example", "minimal") == 2
    assert f"error: {users}: row 2: kind: it must say what it is" in capsys.readouterr().err
    assert run(monkeypatch, "import", "--users", str(users), "--example", "minimal", "--json") == 0
    assert set(json.loads(capsys.readouterr().out)) == {"scenario", "notes"}


def test_a_plan_in_degrees_is_planned_replanned_and_explained(client: TestClient, minimal: dict[str, Any]) -> None:
    """Whatever moves a UAV or lifts a zone drops the degrees that are no longer so."""
    corners = [(47.3970, 8.5450), (47.3970, 8.5490), (47.3990, 8.5490), (47.3995, 8.5470)]
    minimal.pop("area_m")
    minimal["area_deg"] = [{"lat": lat, "lon": lon} for lat, lon in corners]
    minimal["uavs"] = [
        {"id": "uav-1", "start_deg": {"lat": 47.3975, "lon": 8.5470}},
        {"id": "uav-2", "start_deg": {"lat": 47.3980, "lon": 8.5475}, "end_deg": {"lat": 47.3981, "lon": 8.5475}},
    ]
    service = Client(http=client)
    plan = service.plan(Scenario.model_validate(minimal))
    assert plan.scenario.no_fly
    replanned = service.replan(plan.id, failed=["uav-1"], at_slot=2)
    assert replanned.scenario.uavs[0].start_deg is None
    assert replanned.scenario.uavs[0].end_deg is not None
    assert replanned.scenario.area_deg == plan.scenario.area_deg
    joined = {"id": "kiosk", "position_deg": {"lat": 47.3978, "lon": 8.5471}}
    path, origin = f"/v1/plans/{plan.id}/replans?wait_s=30", plan.scenario.origin.model_dump()
    later = client.post(path, json={"at_slot": 2, "users_joined": [joined], "origin": origin}).json()["scenario"]
    assert later["users"][-1]["position_deg"] == joined["position_deg"]
    refused = client.post(path, json={"at_slot": 2, "users_joined": [joined]}).json()["errors"]
    assert [row["field"] for row in refused] == ["users_joined.0.position_m"]
    elsewhere = {**origin, "lat_deg": origin["lat_deg"] + 0.001}
    refused = client.post(path, json={"at_slot": 2, "users_joined": [joined], "origin": elsewhere}).json()["errors"]
    assert [row["field"] for row in refused] == ["origin"]
    assert service.explanation(plan.id).users
    assert Plan.model_validate_json(plan.model_dump_json()) == plan
