"""Keys and the dashboard: a browser without one is led to the sign-in page, a script is told."""

import asyncio
from pathlib import Path

from fastapi.testclient import TestClient

from skyfolio.api.access.api_keys import KeyRing, Role
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.store import Database


async def _key(url: str) -> str:
    database = await Database.open(url)
    try:
        return await KeyRing(database).create("tower", Role.VIEWER)
    finally:
        await database.close()


def test_a_browser_without_a_key_is_led_to_the_sign_in_page(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path / 'keys.db'}"
    key = asyncio.run(_key(url))
    with TestClient(create_app(Settings(database_url=url, warm_up=False)), follow_redirects=False) as client:
        refused = client.get("/ui/plan", headers={"accept": "text/html"})
        assert (refused.status_code, refused.headers["location"]) == (303, "/login")
        assert client.get("/ui/plan").status_code == 401
        assert client.get("/v1/operations", headers={"accept": "text/html"}).status_code == 401
        assert client.post("/login", json={"key": key}).status_code == 204
        assert client.get("/v1/operations").status_code == 200
