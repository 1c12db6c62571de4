"""Who may do what: every route against every role, with keys that exist, are revoked, or never were."""

import asyncio
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from sqlalchemy import select, text

from skyfolio.api.access.api_keys import KeyRing, Role
from skyfolio.api.common.errors import ConflictError, InvalidError
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.middleware import MOST_BUCKETS, OPEN_PATHS, TokenBuckets
from skyfolio.api.http.server import require_safe
from skyfolio.api.store import Database
from skyfolio.api.store.tables import api_keys

NEEDED = {
    ("GET", "/v1/plans/{plan_id}/contingencies"): Role.PLANNER,
    ("GET", "/v1/plans/{plan_id}/explanation"): Role.PLANNER,
    ("POST", "/v1/plans:preview"): Role.PLANNER,
    ("POST", "/v1/plans/{plan_id}/robustness"): Role.PLANNER,
    ("POST", "/v1/plans"): Role.PLANNER,
    ("POST", "/v1/plans/{plan_id}/replans"): Role.PLANNER,
    ("POST", "/v1/plans/{plan_id}:cancel"): Role.PLANNER,
    ("POST", "/v1/operations/{operation_id}/allocations:acknowledge"): Role.PLANNER,
    ("POST", "/v1/operations/{operation_id}/measurements"): Role.PLANNER,
    ("POST", "/v1/scenarios:import"): Role.VIEWER,
    ("POST", "/v1/scenarios:validate"): Role.VIEWER,
    ("GET", "/v1/audit"): Role.PILOT,
    ("GET", "/v1/webhooks"): Role.PILOT,
    ("GET", "/v1/webhooks/{webhook_id}"): Role.PILOT,
}
"""What is not the rule: who reads is a viewer, who changes anything is a pilot."""
GUESTS = [None, "sky_000000000000_guess", "nonsense", "sky_' OR 1=1 --_x", "é" * 300]


async def make_keys(url: str) -> dict[str, str]:
    database = await Database.open(url)
    ring = KeyRing(database)
    made = {role.value: await ring.create(f"a {role.value}", role) for role in Role}
    made["revoked"] = await ring.create("gone", Role.PILOT)
    await ring.revoke(made["revoked"].split("_")[1])
    await database.close()
    return made


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, dict[str, str]]]:
    url = f"sqlite+aiosqlite:///{tmp_path_factory.mktemp('guarded')}/service.db"
    keys = asyncio.run(make_keys(url))
    settings = Settings(database_url=url, warm_up=False, failed_keys_per_minute=10_000)
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        yield client, keys


def routes(client: TestClient) -> list[tuple[str, str]]:
    app = client.app
    assert isinstance(app, FastAPI)
    return [
        (method.upper(), path)
        for path, methods in app.openapi()["paths"].items()
        for method in methods
        if path not in OPEN_PATHS
    ]


def needed(method: str, path: str) -> Role:
    return NEEDED.get((method, path), Role.VIEWER if method == "GET" else Role.PILOT)


def filled(path: str) -> str:
    return re.sub(r"\{incident\}", "1", re.sub(r"\{(?!incident)[a-z_]+\}", "none", path))


def ask(client: TestClient, method: str, path: str, key: str | None) -> int:
    headers = {} if key is None else {"Authorization": f"Bearer {key}".encode()}
    params = {"follow": False} if path == "/v1/events" else {}
    return client.request(method, filled(path), headers=headers, params=params).status_code  # type: ignore[arg-type]


def test_every_route_lets_exactly_the_roles_in_that_it_is_for(guarded: tuple[TestClient, dict[str, str]]) -> None:
    client, keys = guarded
    wrong = []
    for method, path in routes(client):
        for role in Role:
            passed = ask(client, method, path, keys[role.value]) not in {401, 403}
            if passed != role.covers(needed(method, path)):
                wrong.append((method, path, role.value, passed))
    assert len(routes(client)) > 25
    assert wrong == []


def test_nobody_comes_in_without_a_key_that_works(guarded: tuple[TestClient, dict[str, str]]) -> None:
    client, keys = guarded
    for method, path in routes(client):
        for key in [*GUESTS, keys["revoked"], keys["pilot"][:-1]]:
            assert ask(client, method, path, key) == 401, (method, path, key)


def test_health_needs_no_key_and_the_refusal_says_what_to_send(guarded: tuple[TestClient, dict[str, str]]) -> None:
    client, _ = guarded
    assert client.get("/ready").status_code == 200
    refused = client.get("/v1/plans")
    assert refused.headers["WWW-Authenticate"].startswith("Bearer")
    assert "skyfolio keys create" in refused.json()["detail"]
    assert client.get("/ui/").status_code == 401


def test_a_browser_gets_a_cookie_that_opens_the_event_stream(guarded: tuple[TestClient, dict[str, str]]) -> None:
    client, keys = guarded
    assert client.post("/login", json={"key": "nonsense"}).status_code == 401
    answer = client.post("/login", json={"key": keys["viewer"]})
    assert answer.status_code == 204
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    try:
        assert client.get("/v1/events", params={"follow": False}).status_code == 200
        assert client.post("/v1/plans", json={}).status_code == 403
    finally:
        client.cookies.clear()


def test_who_did_what_is_written_down_and_keys_are_not(
    guarded: tuple[TestClient, dict[str, str]], caplog: pytest.LogCaptureFixture
) -> None:
    client, keys = guarded
    pilot = {"X-API-Key": keys["pilot"], "X-Request-ID": "audit-me"}
    client.post("/v1/operations", json={"plan_id": "plan-0"}, headers=pilot)
    client.post("/v1/operations", json={}, headers={"X-API-Key": keys["viewer"]})
    client.post("/v1/operations", json={})
    assert client.portal is not None
    assert isinstance(client.app, FastAPI)
    client.portal.call(client.app.state.service.database.write, text("SELECT 1"))  # what was written before is there
    rows = client.get("/v1/audit", params={"limit": 200}, headers=pilot).json()["items"]
    mine = next(row for row in rows if row["request_id"] == "audit-me")
    assert mine["principal"] == "a pilot"
    assert (mine["method"], mine["path"], mine["status"]) == ("POST", "/v1/operations", 404)
    assert any(row["principal"] == "a viewer" and row["status"] == 403 for row in rows)
    assert any(row["role"] == "none" and row["status"] == 401 for row in rows)
    assert keys["pilot"] not in str(rows) + caplog.text


def test_another_address_than_loopback_needs_keys_first(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path}/service.db"
    for host in ("0.0.0.0", "::", "192.168.7.7", "example.org"):  # noqa: S104
        with pytest.raises(InvalidError, match="host: "):
            require_safe(Settings(host=host, database_url=url))
    for host in ("127.0.0.1", "::1", "localhost"):
        require_safe(Settings(host=host, database_url=url))
    asyncio.run(make_keys(url))
    require_safe(Settings(host="0.0.0.0", database_url=url))  # noqa: S104


def test_even_without_keys_an_open_address_lets_nobody_in(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path}/service.db"
    settings = Settings(host="0.0.0.0", database_url=url, warm_up=False)  # noqa: S104
    with TestClient(create_app(settings)) as client:
        assert client.get("/v1/plans").status_code == 401


async def test_keys_are_kept_as_digests_and_a_revoked_one_ends(database_url: str) -> None:
    database = await Database.open(database_url)
    ring = KeyRing(database)
    assert not await ring.in_use()
    key = await ring.create("someone", Role.PLANNER)
    assert key.split("_", 2)[2] not in str(await database.rows(select(api_keys)))
    found = await ring.identify(key)
    assert found is not None
    assert (found.name, found.role) == ("someone", Role.PLANNER)
    await ring.revoke(key.split("_")[1])
    assert await ring.identify(key) is None
    await database.close()


@pytest.mark.parametrize("spend", [lambda bucket: [bucket.take("a", 0.0) for _ in range(12)]])
def test_a_burst_is_taken_and_then_the_rate_holds(spend: Callable[[TokenBuckets], list[bool]]) -> None:
    bucket = TokenBuckets(rate_per_s=2, burst=10)
    assert spend(bucket) == [True] * 10 + [False] * 2
    assert [bucket.take("a", at) for at in (0.1, 0.6, 1.1, 1.2)] == [False, True, True, False]
    assert bucket.take("b", 0.0)


def test_many_other_clients_do_not_refill_the_bucket_of_one_that_keeps_asking() -> None:
    buckets = TokenBuckets(rate_per_s=0.001, burst=1)
    assert buckets.take("greedy", 0.0)
    for number in range(2 * MOST_BUCKETS):
        buckets.take(f"other-{number}", 0.0)
        if number % 1_000 == 0:
            assert not buckets.take("greedy", 0.0)


def test_too_many_requests_are_told_to_wait(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path}/service.db"
    settings = Settings(rate_per_s=1, rate_burst=3, database_url=url, warm_up=False)
    with TestClient(create_app(settings)) as client:
        answers = [client.get("/v1/scenarios/examples") for _ in range(6)]
    assert [answer.status_code for answer in answers][:3] == [200] * 3
    assert 429 in [answer.status_code for answer in answers]
    assert answers[-1].headers["Retry-After"]


async def test_revoking_the_last_key_closes_the_service_until_the_keys_are_reset(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path}/service.db"
    database = await Database.open(url)
    ring = KeyRing(database)
    key = (await ring.create("only", Role.PILOT)).split("_")[1]
    with pytest.raises(ConflictError, match=key):
        await ring.reset()
    await ring.revoke(key)
    await database.close()

    def status(client: TestClient) -> int:
        return client.get("/v1/plans").status_code

    settings = Settings(database_url=url, warm_up=False)
    with TestClient(create_app(settings)) as client:
        assert status(client) == 401
    database = await Database.open(url)
    assert await KeyRing(database).reset() == 1
    await database.close()
    with TestClient(create_app(settings)) as client:
        assert status(client) == 200
