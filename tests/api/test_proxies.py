"""Behind a reverse proxy: the sub-path stays, clients are told apart, and nobody becomes local by it."""

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn
from fastapi.testclient import TestClient
from pydantic import ValidationError

from skyfolio.api.access.api_keys import KeyRing, Role
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.connections import HeaderTimeoutProtocol
from skyfolio.api.http.proxies import FORWARDED
from skyfolio.api.store import Database
from tests.ports import free_port
from tests.proxy import Proxy, running

PREFIX = "/sky/one"
OWN = "http://127.0.0.1"


async def make_key(url: str) -> str:
    database = await Database.open(url)
    try:
        return await KeyRing(database).create("tower", Role.PILOT)
    finally:
        await database.close()


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite+aiosqlite:///{tmp_path}/service.db"


@contextmanager
def served(url: str, **settings: Any) -> Iterator[int]:
    """The service behind a real server in a thread, as `skyfolio serve` sets it up; its port."""
    port = free_port(socket.SOCK_STREAM)
    app = create_app(Settings(database_url=url, warm_up=False, **settings))
    config = uvicorn.Config(
        app, port=port, http=HeaderTimeoutProtocol, log_config=None, access_log=False, proxy_headers=False
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        threading.Event().wait(0.02)
    try:
        yield port
    finally:
        server.should_exit = True
        thread.join()


@pytest.mark.parametrize("strips", [True, False])
@pytest.mark.parametrize("told", ["by the setting", "by the proxy"])
def test_below_a_sub_path_everything_stays_below_it(url: str, minimal: dict[str, Any], told: str, strips: bool) -> None:
    key = asyncio.run(make_key(url))
    settings = {"root_path": PREFIX} if told == "by the setting" else {"trusted_proxies": "127.0.0.1"}
    added = {"X-Forwarded-Prefix": PREFIX, "X-Forwarded-For": "192.0.2.7"} if told == "by the proxy" else {}
    proxy_of = {"strips": strips, "headers": added}
    with (
        served(url, **settings) as port,
        running(Proxy(port, PREFIX, **proxy_of)) as proxy,  # type: ignore[arg-type]
        httpx2.Client(base_url=proxy.url, timeout=60) as browser,
    ):
        refused = browser.get(f"{PREFIX}/ui/plan", headers={"accept": "text/html"})
        assert (refused.status_code, refused.headers["location"]) == (303, f"{PREFIX}/login")
        assert browser.get(refused.headers["location"]).status_code == 200
        answer = browser.post(f"{PREFIX}/login", json={"key": key}, headers={"origin": proxy.url})
        assert answer.status_code == 204
        assert f"path={PREFIX};" in answer.headers["set-cookie"].lower()
        made = browser.post(f"{PREFIX}/v1/plans", json=minimal)
        assert made.status_code == 202
        assert made.headers["location"].startswith(f"{PREFIX}/v1/plans/plan-")
        assert browser.get(made.headers["location"]).json()["id"] == made.json()["id"]
        described = browser.get(f"{PREFIX}/openapi.json").json()
        assert described["servers"] == [{"url": PREFIX}]
        assert 'src="docs/assets/' in browser.get(f"{PREFIX}/docs").text
        for asset in ("swagger-ui-bundle.js", "swagger-ui.css"):
            assert len(browser.get(f"{PREFIX}/docs/assets/{asset}").content) > 100_000
        direct = browser.get(f"http://127.0.0.1:{port}/v1/plans", headers={"x-api-key": key})
        assert direct.status_code == 200  # without the proxy it is as ever


def test_a_prefix_is_believed_of_trusted_proxies_only(url: str) -> None:
    with TestClient(create_app(Settings(database_url=url, warm_up=False)), base_url=OWN) as client:
        asyncio.run(make_key(url))
        for prefix in ("/evil", "//evil.example", '/"><script>'):
            headers = {"accept": "text/html", "x-forwarded-prefix": prefix}
            assert client.get("/ui/", headers=headers, follow_redirects=False).headers["location"] == "/login"


def test_a_prefix_that_is_no_path_is_no_prefix(url: str) -> None:
    asyncio.run(make_key(url))
    app = create_app(Settings(database_url=url, warm_up=False, trusted_proxies="192.0.2.0/24"))
    with TestClient(app, base_url=OWN, client=("192.0.2.9", 1), follow_redirects=False) as client:
        for prefix in ("//evil.example", '/"><script>', "evil", "/a b"):
            answer = client.get("/ui/", headers={"accept": "text/html", "x-forwarded-prefix": prefix})
            assert answer.headers["location"] == "/login"


@pytest.mark.parametrize("trusted", ["", "127.0.0.1"])
def test_without_keys_nobody_becomes_local_through_a_proxy(url: str, trusted: str) -> None:
    app = create_app(Settings(database_url=url, warm_up=False, trusted_proxies=trusted))
    with TestClient(app, base_url=OWN, client=("127.0.0.1", 1)) as client:
        for header in FORWARDED:
            value = "127.0.0.1" if "host" not in header else "localhost"
            refused = client.get("/v1/operations", headers={header: value})
            assert refused.status_code == 403
            assert "skyfolio keys create" in refused.json()["detail"]
            assert client.get("/health", headers={header: value}).status_code == 200
            assert client.get("/v1/operations").status_code == 200


def test_wrong_keys_count_for_the_client_and_not_for_the_proxy(url: str) -> None:
    asyncio.run(make_key(url))
    settings = Settings(database_url=url, warm_up=False, trusted_proxies="127.0.0.1", failed_keys_per_minute=2)
    with TestClient(create_app(settings), base_url=OWN, client=("127.0.0.1", 1)) as client:

        def status(count: int, forwarded: str) -> int:
            headers = {"authorization": f"Bearer sky_{count}_x", "x-forwarded-for": forwarded}
            return client.get("/v1/plans", headers=headers).status_code

        assert [status(count, "192.0.2.1") for count in range(4)] == [401, 401, 429, 429]
        assert status(9, "192.0.2.2") == 401
        assert status(9, "192.0.2.3, 192.0.2.1") == 429  # what the client says of itself does not count


def test_who_is_not_trusted_cannot_say_to_be_somebody_else(url: str) -> None:
    asyncio.run(make_key(url))
    settings = Settings(database_url=url, warm_up=False, failed_keys_per_minute=2)
    with TestClient(create_app(settings), base_url=OWN, client=("127.0.0.1", 1)) as client:
        for count, status in enumerate([401, 401, 429, 429]):
            headers = {"authorization": f"Bearer sky_{count}_x", "x-forwarded-for": f"192.0.2.{count}"}
            assert client.get("/v1/plans", headers=headers).status_code == status


def test_the_cookie_is_for_tls_only_where_there_is_tls(url: str) -> None:
    key = asyncio.run(make_key(url))
    app = create_app(
        Settings(database_url=url, warm_up=False, trusted_proxies="127.0.0.1", allowed_hosts="fleet.example")
    )
    with TestClient(app, base_url=OWN, client=("127.0.0.1", 1)) as client:
        for proto, secure in (("https", True), ("http", False)):
            said = {"x-forwarded-proto": proto, "x-forwarded-host": "fleet.example"}
            answer = client.post("/login", json={"key": key}, headers={**said, "origin": f"{proto}://fleet.example"})
            assert answer.status_code == 204
            assert ("secure" in answer.headers["set-cookie"].lower()) == secure


@pytest.mark.parametrize("bad", [{"root_path": "sky"}, {"root_path": "/sky/"}, {"trusted_proxies": "nginx"}])
def test_settings_that_mean_nothing_are_refused_by_name(bad: dict[str, str]) -> None:
    with pytest.raises(ValidationError, match=next(iter(bad))):
        Settings(**bad)  # type: ignore[arg-type]


def test_the_page_of_the_description_asks_nobody_else(client: TestClient) -> None:
    html = client.get("/docs").text
    assert "http://" not in html
    assert "https://" not in html
