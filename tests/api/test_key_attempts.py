"""Wrong keys: some a minute from each address, and operators whose keys are right are let in all the same."""

from collections.abc import AsyncIterator
from pathlib import Path

import httpx2
import pytest

from skyfolio.api.access.api_keys import KeyRing, Role
from skyfolio.api.access.key_attempts import KeyAuthenticator
from skyfolio.api.common.errors import TooManyRequestsError
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.store import Database


@pytest.fixture
async def ring(tmp_path: Path) -> AsyncIterator[KeyRing]:
    database = await Database.open(f"sqlite+aiosqlite:///{tmp_path}/service.db")
    yield KeyRing(database)
    await database.close()


async def refused_after(authenticator: KeyAuthenticator, client: str, most: int) -> int:
    for count in range(most):
        try:
            found = await authenticator.identify(client, f"sky_000000000000_{count}")
        except TooManyRequestsError as error:
            return count if 0 < error.retry_after_s <= 60 else -1
        assert found is None
    return most


async def test_an_address_may_try_some_wrong_keys_a_minute_and_others_are_not_held_to_it(ring: KeyRing) -> None:
    authenticator = KeyAuthenticator(ring, per_minute=5)
    assert await refused_after(authenticator, "192.0.2.1", 50) == 5
    assert await refused_after(authenticator, "192.0.2.2", 50) == 5
    assert await refused_after(authenticator, "2001:db8::1", 50) == 5
    assert await refused_after(authenticator, "2001:db8::2:9", 50) == 0  # the same network of one owner
    assert await refused_after(authenticator, "2001:db8:0:1::1", 50) == 5


async def test_a_key_that_was_right_before_is_taken_while_its_address_is_held_off(ring: KeyRing) -> None:
    authenticator = KeyAuthenticator(ring, per_minute=5)
    old, new = await ring.create("tower", Role.PILOT), await ring.create("new", Role.PILOT)
    assert await authenticator.identify("192.0.2.1", old) is not None
    await refused_after(authenticator, "192.0.2.1", 50)
    found = await authenticator.identify("192.0.2.1", old)
    assert found is not None
    assert found.name == "tower"
    with pytest.raises(TooManyRequestsError):  # else an answer would tell right from wrong
        await authenticator.identify("192.0.2.1", new)
    await ring.revoke(old.split("_")[1])
    assert await authenticator.identify("192.0.2.1", old) is None
    with pytest.raises(TooManyRequestsError):
        await authenticator.identify("192.0.2.1", old)


async def test_wrong_keys_end_in_429_wherever_they_are_tried(tmp_path: Path, ring: KeyRing) -> None:
    await ring.create("tower", Role.PILOT)
    settings = Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db", warm_up=False, failed_keys_per_minute=6
    )
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        statuses: list[int] = []
        transport = httpx2.ASGITransport(app=app)
        async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            for count in range(4):
                wrong = f"sky_00000000000{count}_x"
                bearer = await client.get("/v1/plans", headers={"authorization": f"Bearer {wrong}"})
                cookie = await client.get("/v1/plans", headers={"cookie": f"skyfolio_key={wrong}"})
                answer = await client.post("/login", json={"key": wrong})
                statuses += [bearer.status_code, cookie.status_code, answer.status_code]
            assert (await client.get("/v1/plans")).status_code == 401  # nothing was tried
        assert statuses == [401] * 6 + [429] * 6
        assert int(answer.headers["retry-after"]) > 1
