"""A browser on this machine is not its user: foreign hosts, pages of other origins, and bodies that forms can send."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from starlette.datastructures import Headers
from starlette.websockets import WebSocket, WebSocketDisconnect

from skyfolio.api.common.errors import CrossSiteError, MediaTypeError, MisdirectedError
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.origin_checks import AllowedHosts, require_json, require_same_origin
from skyfolio.api.http.response_headers import dashboard_policy

OWN = "http://127.0.0.1:8080"
FORM = "application/x-www-form-urlencoded"


@pytest.fixture(scope="module")
def keyless() -> Iterator[TestClient]:
    """A service on loopback without keys, as a browser on this machine reaches it."""
    settings = Settings(warm_up=False, allowed_hosts="fleet.example, *.uav.example")
    with TestClient(create_app(settings), base_url=OWN) as client:
        yield client


def asked(**headers: str) -> Headers:
    return Headers({name.replace("_", "-"): value for name, value in headers.items()})


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "192.0.2.7", "", "a@b"]
)
def test_a_name_that_is_not_ours_is_misdirected_whoever_it_leads_to(keyless: TestClient, host: str) -> None:
    for path in ("/v1/operations", "/ui/", "/health", "/docs", "/login"):
        refused = keyless.get(path, headers={"host": host})
        assert refused.status_code == 421
        assert refused.headers["content-type"] == "application/problem+json"
        assert "SKYFOLIO_ALLOWED_HOSTS" in refused.json()["detail"]


@pytest.mark.parametrize(
    "host", ["localhost:8080", "LOCALHOST.", "127.0.0.1", "[::1]:8080", "fleet.example", "a.uav.example"]
)
def test_loopback_and_the_names_of_the_settings_are_ours(keyless: TestClient, host: str) -> None:
    assert keyless.get("/v1/operations", headers={"host": host}).status_code == 200


def test_bound_to_all_addresses_any_address_is_ours_but_no_foreign_name() -> None:
    hosts = AllowedHosts(Settings(host="0.0.0.0"))  # noqa: S104
    for host in ("192.0.2.7:8080", "[2001:db8::7]", "localhost"):
        hosts.require(asked(host=host))
    with pytest.raises(MisdirectedError):
        hosts.require(asked(host="evil.example"))


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "https://127.0.0.1:8081", "x"]
)
@pytest.mark.parametrize("method", ["POST", "GET", "DELETE"])
def test_a_page_of_another_origin_may_not_ask(keyless: TestClient, method: str, origin: str) -> None:
    refused = keyless.request(method, "/v1/operations/op-0:abort", headers={"origin": origin})
    assert (refused.status_code, refused.json()["type"]) == (403, "urn:skyfolio:problem:cross-site")


def test_our_own_pages_and_programs_that_are_no_browsers_may_ask(keyless: TestClient, minimal: dict[str, Any]) -> None:
    for headers in ({}, {"origin": OWN}, {"origin": OWN, "sec-fetch-site": "same-origin"}):
        assert keyless.post("/v1/scenarios:validate", json=minimal, headers=headers).status_code == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_browser_that_only_says_where_the_page_is_from_is_believed(keyless: TestClient, site: str) -> None:
    headers = {"sec-fetch-site": site}
    assert keyless.post("/v1/operations/op-0:abort", headers=headers).status_code == 403
    assert keyless.get("/v1/operations", headers=headers).status_code == 200  # a link to us is no request of the page


@pytest.mark.parametrize(
    ("host", "origin"), [("h", "https://h"), ("h:80", "http://h"), ("[::1]:8080", "http://[::1]:8080")]
)
def test_default_ports_and_brackets_make_no_other_origin(host: str, origin: str) -> None:
    hosts = AllowedHosts(Settings(allowed_hosts="h"))
    require_same_origin(asked(origin=origin), hosts.require(asked(host=host)), safe=False)
    with pytest.raises(CrossSiteError):
        require_same_origin(
            asked(origin=f"{origin}1" if origin[-1].isdigit() else f"{origin}:81"),
            hosts.require(asked(host=host)),
            safe=False,
        )


@pytest.mark.parametrize("kind", [FORM, "text/plain", "multipart/form-data; boundary=x", "application/jsonx", ""])
@pytest.mark.parametrize("body", ['{"action": "land"}', ""])
def test_what_a_form_can_send_is_not_taken(keyless: TestClient, kind: str, body: str) -> None:
    refused = keyless.post("/v1/operations/op-0:abort", content=body, headers={"content-type": kind})
    assert refused.status_code == 415
    assert "must be application/json" in refused.json()["detail"]


def test_a_body_without_a_type_is_not_taken_and_no_body_needs_none() -> None:
    for headers in (
        asked(),
        asked(content_length="0"),
        asked(content_length="2", content_type="application/json; charset=utf-8"),
    ):
        require_json(headers)
    for headers in (asked(content_length="2"), asked(transfer_encoding="chunked")):
        with pytest.raises(MediaTypeError):
            require_json(headers)


@pytest.mark.parametrize(
    ("headers", "let_in"),
    [
        ({"origin": OWN}, True),
        ({}, True),
        ({"origin": "http://evil.example"}, False),
        ({"host": "evil.example"}, False),
    ],
)
def test_the_socket_of_the_dashboard_is_for_its_own_pages(
    tmp_path: Path, headers: dict[str, str], let_in: bool
) -> None:
    app = create_app(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/x.db", warm_up=False))

    @app.websocket("/ui/socket")
    async def echo(socket: WebSocket) -> None:
        await socket.accept()
        await socket.close()

    asked = {"host": "127.0.0.1:8080", **headers}
    with TestClient(app, base_url=OWN) as client:
        if let_in:
            with client.websocket_connect("/ui/socket", headers=asked):
                pass
        else:
            with pytest.raises(WebSocketDisconnect) as closed, client.websocket_connect("/ui/socket", headers=asked):
                pass
            assert closed.value.code == 1008


def test_no_answer_may_be_framed_sniffed_or_run_scripts_that_are_not_its_own(keyless: TestClient) -> None:
    for path in ("/v1/operations", "/health", "/docs", "/login", "/none", "/metrics"):
        answer = keyless.get(path)
        policy = answer.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in policy
        assert "default-src 'none'" in policy or "script-src 'self' 'sha256-" in policy
        assert "'unsafe-eval'" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "same-origin"
        assert answer.headers["x-frame-options"] == "DENY"


def test_the_map_server_is_the_only_stranger_that_the_dashboard_may_ask() -> None:
    assert "http" not in dashboard_policy(None)
    policy = dashboard_policy("https://{s}.tiles.example:8443/{z}/{x}/{y}.png")
    assert "img-src 'self' data: blob: https://*.tiles.example:8443;" in policy
    assert policy.count("http") == 1
