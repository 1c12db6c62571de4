"""Hostile input: it is refused with a problem that says why, and the service goes on."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

JSON = {"content-type": "application/json"}


@pytest.fixture(autouse=True)
def still_well(client: TestClient) -> Iterator[None]:
    yield
    assert client.get("/v1/scenarios/examples").status_code == 200


def refused(answer: Any, *statuses: int) -> dict[str, Any]:
    assert answer.status_code in statuses, answer.text[:300]
    assert answer.headers["content-type"] == "application/problem+json"
    body: dict[str, Any] = answer.json()
    assert body["detail"]
    return body


def test_a_body_of_ten_megabytes_is_too_large(client: TestClient) -> None:
    refused(client.post("/v1/plans", content=b" " * 10_000_000, headers=JSON), 413)


def test_a_body_that_hides_its_size_is_cut_off(client: TestClient) -> None:
    def endless() -> Iterator[bytes]:
        for _ in range(100):
            yield b" " * 100_000

    refused(client.post("/v1/plans", content=endless(), headers=JSON), 413)
    refused(client.post("/v1/plans", content=b"{}", headers={**JSON, "content-length": "9" * 30}), 413)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"a":' * 50_000,
        "9" * 100_000,
        '{"slots": 1e999}',
        "\x00",
        '"\\ud800"',
        "",
        "null",
        "[]",
        '{"slots": ' + "9" * 4000 + "}",
        "﻿{}",
    ],
    ids=lambda text: repr(text[:8]),
)
def test_json_that_is_deep_long_or_broken_is_refused(client: TestClient, text: str) -> None:
    for path in ("/v1/plans", "/v1/scenarios:validate", "/v1/operations", "/v1/fleet/vehicles", "/v1/drills"):
        refused(client.post(path, content=text.encode(), headers=JSON), 400, 422)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e400", "-1e400", str(10**400)])
def test_numbers_that_are_none_are_refused(client: TestClient, minimal: dict[str, Any], number: str) -> None:
    text = json.dumps(minimal).replace('"altitude_m": 30.0', f'"altitude_m": {number}')
    assert number in text
    body = refused(client.post("/v1/plans", content=text, headers=JSON), 422)
    assert body["errors"][0]["field"] == "altitude_m"


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("uavs", {"uavs": [{"id": f"u{n}", "start_m": [n, 0]} for n in range(129)], "area_m": [[0, 0], [199, 99]]}),
        ("users", {"users": [{"id": f"k{n}", "position_m": [n, 0]} for n in range(5001)]}),
        ("slots", {"slots": 2001}),
        (
            "slots",
            {
                "slots": 2000,
                "users": [{"id": f"k{n}", "position_m": [n, 0]} for n in range(1001)],
            },
        ),
    ],
)
def test_scenarios_beyond_the_limits_are_refused_by_field(
    client: TestClient, minimal: dict[str, Any], field: str, change: dict[str, Any]
) -> None:
    for path in ("/v1/plans", "/v1/scenarios:validate"):
        body = refused(client.post(path, json={**minimal, "min_separation_m": 0.5, **change}), 422)
        assert body["errors"][0]["field"] == field


@pytest.mark.parametrize(
    "name",
    [
        "..%2f..%2fetc%2fpasswd",
        "%00",
        "plan-0%0d%0aSet-Cookie:x",
        "a" * 5000,
        "%F0%9F%9B%B8",
        "'; DROP TABLE plans; --",
        "$(id)",
        "%ff",
    ],
)
def test_tricks_in_paths_find_nothing(client: TestClient, name: str) -> None:
    for path in ("/v1/plans/{}", "/v1/operations/{}", "/v1/drills/{}", "/v1/scenarios/examples/{}", "/v1/plans/{}:x"):
        answer = client.get(path.format(name))
        refused(answer, 404, 405)
        assert "set-cookie" not in answer.headers


@pytest.mark.parametrize("value", ["-1", "x", "9" * 400, "1.5", "NaN", "0x10", "1;2"])
def test_a_bad_last_event_id_is_refused(client: TestClient, value: str) -> None:
    refused(client.get("/v1/events", params={"follow": False}, headers={"Last-Event-ID": value}), 422)


def test_an_event_id_from_the_future_gets_nothing_old(client: TestClient) -> None:
    answer = client.get("/v1/events", params={"follow": False}, headers={"Last-Event-ID": str(2**52)})
    assert answer.status_code == 200
    assert answer.text == ""


@pytest.mark.parametrize(
    ("header", "value"),
    [("Idempotency-Key", ""), ("Idempotency-Key", "k" * 300), ("If-Match", "garbage"), ("If-Match", '"' * 300)],
)
def test_bad_headers_are_refused(client: TestClient, minimal: dict[str, Any], header: str, value: str) -> None:
    path, body = ("/v1/plans", minimal) if header == "Idempotency-Key" else ("/v1/operations/op-0:pause", {})
    refused(client.post(path, json=body, headers={header: value}), 404, 422)


def test_a_request_id_cannot_smuggle_lines_into_the_log(client: TestClient) -> None:
    answer = client.get("/health", headers={"X-Request-ID": "x y\tz"})
    assert answer.headers["X-Request-ID"] != "x y\tz"


@pytest.mark.parametrize("path", ["/v1/scenarios:validate", "/v1/operations/none/measurements"])
def test_a_list_where_an_object_belongs_is_refused_in_the_words_of_json(client: TestClient, path: str) -> None:
    answer = client.post(path, json=[{"uav_id": "uav-1"}])
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["message"] == "Input should be a JSON object"
