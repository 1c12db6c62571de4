"""A revoked key ends what was opened with it: streams of events, and the websocket of the dashboard."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn
from starlette.types import Message

from skyfolio.api.access.api_keys import KeyRing, Role
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.middleware import AdmissionMiddleware
from skyfolio.api.store import Database
from tests.lateness import lateness
from tests.ports import free_port

SOON_S = 2.5
"""On a machine that lets nobody wait."""
Revoke = Callable[[str], Awaitable[None]]


@pytest.fixture
async def ring(tmp_path: Path) -> AsyncIterator[KeyRing]:
    """The keys as another process sees them, `skyfolio keys` for one."""
    database = await Database.open(url(tmp_path))
    yield KeyRing(database)
    await database.close()


def url(folder: Path) -> str:
    return f"sqlite+aiosqlite:///{folder}/service.db"


@pytest.fixture
async def served(tmp_path: Path, ring: KeyRing) -> AsyncIterator[tuple[Any, str]]:
    """The application behind a real server, and its address."""
    await ring.create("someone else", Role.VIEWER)  # keys stay in use
    app = create_app(Settings(database_url=url(tmp_path), warm_up=False))
    port = free_port(socket.SOCK_STREAM)
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_config=None, access_log=False))
    running = asyncio.create_task(server.serve())
    while not server.started:  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    yield app, f"http://127.0.0.1:{port}"
    server.should_exit = True
    await running


@pytest.mark.parametrize("telemetry", [False, True])
async def test_the_stream_of_a_revoked_key_ends_and_those_of_others_go_on(
    served: tuple[Any, str], ring: KeyRing, telemetry: bool
) -> None:
    app, address = served
    keys = {name: await ring.create(name, Role.VIEWER) for name in ("leaver", "stayer")}
    ended: dict[str, float] = {}
    heard: dict[str, int] = dict.fromkeys(keys, 0)

    async def listen(name: str, client: httpx2.AsyncClient) -> None:
        headers = {"Authorization": f"Bearer {keys[name]}"}
        path = f"{address}/v1/events?telemetry={telemetry}"
        async with client.stream("GET", path, headers=headers, timeout=60) as stream:
            assert stream.status_code == 200
            async for _ in stream.aiter_bytes():
                heard[name] += 1
        ended[name] = time.monotonic()

    async with httpx2.AsyncClient() as client, lateness() as late:
        listeners = {name: asyncio.create_task(listen(name, client)) for name in keys}
        async with asyncio.timeout(60):
            while app.state.service.events.followers < 2 or not all(heard.values()):  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            revoked_at = time.monotonic()
            await ring.revoke(keys["leaver"].split("_")[1])
            while not listeners["leaver"].done():
                app.state.service.events.publish_telemetry({})  # a stream that is never quiet is looked after too
                await asyncio.sleep(0.02)
        await listeners["leaver"]
        assert ended["leaver"] - revoked_at < SOON_S + late.late_s
        app.state.service.events.add("still_here")
        before = heard["stayer"]
        async with asyncio.timeout(60):
            while heard["stayer"] == before:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        assert not listeners["stayer"].done()
        listeners["stayer"].cancel()


@pytest.mark.parametrize("chatty", [False, True])
async def test_a_websocket_is_closed_when_its_key_is_revoked(
    served: tuple[Any, str], ring: KeyRing, chatty: bool
) -> None:
    app, _ = served
    key = await ring.create("tower", Role.VIEWER)
    taken: list[str] = []
    sent: list[Message] = []

    async def echo(_scope: Any, receive: Any, send: Any) -> None:
        while (message := await receive())["type"] != "websocket.disconnect":
            taken.append(message["type"])
        await send({"type": "websocket.send", "text": "too late"})

    async def receive() -> Message:
        await asyncio.sleep(0.01 if chatty else 60)
        return {"type": "websocket.receive", "text": "hello"}

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {
        "type": "websocket",
        "path": "/ui/socket",
        "headers": [(b"host", b"127.0.0.1"), (b"cookie", f"skyfolio_key={key}".encode())],
    }
    connected = asyncio.create_task(AdmissionMiddleware(echo, owner=app)(scope, receive, send))
    await asyncio.sleep(0.6)
    assert not connected.done()
    async with lateness() as late, asyncio.timeout(60):
        revoked_at = time.monotonic()
        await ring.revoke(key.split("_")[1])
        await connected
        assert time.monotonic() - revoked_at < SOON_S + late.late_s
    assert bool(taken) == chatty
    assert [(message["type"], message.get("code")) for message in sent] == [("websocket.close", 1008)]
