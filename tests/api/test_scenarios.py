"""Scenarios over HTTP: what is refused, and how."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from fastapi.testclient import TestClient

Body = dict[str, Any]


def broken(change: Callable[[Body], object]) -> Callable[[Body], Body]:
    def apply(scenario: Body) -> Body:
        change(scenario)
        return scenario

    return apply


BAD: dict[str, tuple[Callable[[Body], object], str, str]] = {
    "negative bandwidth": (lambda s: s["uavs"][0].update(bandwidth_hz=-1), "uavs.0.bandwidth_hz", "greater than"),
    "same uav id twice": (lambda s: s["uavs"][1].update(id="uav-1"), "uavs", "unique"),
    "same user id twice": (lambda s: s["users"][1].update(id="user-1"), "users", "unique"),
    "too close": (lambda s: s["uavs"][1].update(start_m=[52, 50]), "uavs", "min_separation_m"),
    "outside": (lambda s: s["uavs"][1].update(start_m=[900, 50]), "uavs.1.start_m", "outside area_m"),
    "nan": (lambda s: s["users"][0].update(position_m=[float("nan"), 0]), "users.0.position_m.0", "finite"),
    "infinite": (lambda s: s.update(altitude_m=float("inf")), "altitude_m", "finite"),
    "zero slots": (lambda s: s.update(slots=0), "slots", "greater than or equal to 1"),
    "fractional slots": (lambda s: s.update(slots=2.5), "slots", "integer"),
    "no users": (lambda s: s.update(users=[]), "users", "at least 1"),
    "no uavs": (lambda s: s.update(uavs=[]), "uavs", "at least 1"),
    "unknown field": (lambda s: s.update(speed=3), "speed", "not permitted"),
    "missing field": (lambda s: s.pop("slots"), "slots", "required"),
    "number as text": (lambda s: s.update(slots="20"), "slots", "integer"),
    "inside-out area": (lambda s: s.update(area_m=[[10, 10], [0, 0]]), "area_m", "west < east"),
    "positive mu": (lambda s: s["utility"].update(mu_per_kbps=1), "utility.mu_per_kbps", "less than or equal to 0"),
    "huge integer": (lambda s: s.update(slots=10**30), "slots", "less than or equal to"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("path", ["/v1/scenarios:validate", "/v1/plans"])
def test_a_malformed_scenario_is_refused_naming_field_and_rule(
    client: TestClient, minimal: Body, case: str, path: str
) -> None:
    change, field, rule = BAD[case]
    body = json.dumps(broken(change)(minimal))
    answer = client.post(path, content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    rows = answer.json()["errors"]
    assert any(row["field"] == field and rule in row["message"] for row in rows), rows


def test_text_that_is_not_json_is_refused(client: TestClient) -> None:
    answer = client.post("/v1/plans", content=b"{oops", headers={"content-type": "application/json"})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["rule"] == "json_invalid"


def test_examples_are_listed_and_valid(client: TestClient) -> None:
    names = client.get("/v1/scenarios/examples").json()["examples"]
    assert "paper" in names
    for name in names:
        scenario = client.get(f"/v1/scenarios/examples/{name}").json()
        verdict = client.post("/v1/scenarios:validate", json=scenario)
        assert verdict.json() == {
            "valid": True,
            "uavs": len(scenario["uavs"]),
            "users": len(scenario["users"]),
            "slots": scenario["slots"],
        }
    assert client.get("/v1/scenarios/examples/none").status_code == 404
