"""The OpenAPI description, and every operation in it under generated input: nothing ends in a 5xx."""

import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
import uvicorn
from fastapi import FastAPI
from hypothesis import HealthCheck, Phase, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import content_type_conformance, response_schema_conformance

from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.routes.plans import PlanRequest
from tests.ports import free_port

EXAMPLES_EACH = 20
APP = create_app(
    Settings(
        rate_per_s=1e6,
        rate_burst=10**6,
        queue_limit=1024,
        solve_deadline_s=0.2,
        plan_ahead=False,
        warm_up=False,
        fleet_url=f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
    )
)
schema = schemathesis.openapi.from_dict(APP.openapi())


@pytest.fixture(scope="module")
def base_url() -> Iterator[str]:
    """The service behind a real server in a thread."""
    port = free_port(socket.SOCK_STREAM)
    server = uvicorn.Server(uvicorn.Config(APP, port=port, log_config=None, access_log=False))
    thread = threading.Thread(target=server.run)
    thread.start()
    ready = threading.Event()
    while not server.started:
        ready.wait(0.05)
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join()


@schema.parametrize()
@settings(
    max_examples=EXAMPLES_EACH,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.generate],
)
def test_no_input_ends_in_a_server_error_and_answers_are_as_described(case: Any, base_url: str) -> None:
    case.query = {**(case.query or {}), **({"follow": "false"} if case.path == "/v1/events" else {})}
    if isinstance(case.query, dict):
        case.query.pop("wait_s", None)  # nobody waits here
        if case.path.endswith(("/contingencies", "/explanation")):
            case.query["wait_s"] = 0
    response = case.call(base_url=base_url)
    case.validate_response(response, checks=[not_a_server_error, response_schema_conformance, content_type_conformance])


def operations() -> Iterator[tuple[str, str, dict[str, Any]]]:
    assert isinstance(APP, FastAPI)
    for path, methods in APP.openapi()["paths"].items():
        for method, operation in methods.items():
            yield method, path, operation


def test_every_operation_says_what_it_does_and_names_its_problems() -> None:
    for method, path, operation in operations():
        assert operation.get("description"), (method, path)
        assert operation["tags"], (method, path)
        if path.startswith("/v1"):
            assert operation["security"], (method, path)
            assert {"401", "403", "429"} <= set(operation["responses"]), (method, path)


def test_every_creating_post_takes_an_idempotency_key() -> None:
    creating = {
        *("/v1/plans", "/v1/plans/{plan_id}/replans", "/v1/fleet/vehicles"),
        *("/v1/operations", "/v1/drills", "/v1/webhooks"),
    }
    for method, path, operation in operations():
        headers = {one["name"] for one in operation.get("parameters", []) if one["in"] == "header"}
        assert ("Idempotency-Key" in headers) == (method == "post" and path in creating), (method, path)


def test_every_command_of_an_operation_takes_an_etag() -> None:
    verbs = {":start", ":pause", ":resume", ":abort", ":readmit", ":retire"}
    for _, path, operation in operations():
        if any(path == f"/v1/operations/{{operation_id}}{verb}" for verb in verbs):
            assert "If-Match" in {one["name"] for one in operation["parameters"]}


def test_the_examples_in_the_description_are_valid_requests() -> None:
    body = APP.openapi()["paths"]["/v1/plans"]["post"]["requestBody"]["content"]["application/json"]
    assert len(body["examples"]) >= 2
    for example in body["examples"].values():
        assert PlanRequest.model_validate(example["value"])
