"""Connections that say nothing or never finish are closed; those that are being answered stay."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator
from typing import Any

import pytest
import uvicorn

from skyfolio.api.http.connections import HEADERS_WITHIN_S, HeaderTimeoutProtocol
from tests.ports import free_port

SOON_S = 0.3
HALF = b"GET / HTTP/1.1\r\nHost: x\r\nX-A: "
WHOLE = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


class Hurried(HeaderTimeoutProtocol):
    headers_within_s = SOON_S


async def app(scope: Any, receive: Any, send: Any) -> None:
    """`/slow` streams for some patiences; everything else answers at once, without reading the body."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await receive()
        await send({"type": "websocket.send", "text": "still here"})
        return
    if scope["type"] != "http":
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    for _ in range(8 if scope["path"] == "/slow" else 0):
        await asyncio.sleep(SOON_S / 2)
        await send({"type": "http.response.body", "body": b"x", "more_body": True})
    await send({"type": "http.response.body", "body": b"end"})


@pytest.fixture(params=[Hurried])
async def port(request: pytest.FixtureRequest) -> AsyncIterator[int]:
    made = free_port(socket.SOCK_STREAM)
    config = uvicorn.Config(
        app, port=made, http=request.param, log_config=None, access_log=False, timeout_keep_alive=60
    )
    server = uvicorn.Server(config)
    running = asyncio.create_task(server.serve())
    while not server.started:  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    yield made
    server.should_exit = True
    await running


async def closed_after(port: int, *chunks: bytes, dripping: bytes = b"") -> float:
    """Seconds until the service closes a connection on which this is sent, and then drips on."""
    began = time.monotonic()
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for chunk in chunks:
        writer.write(chunk)

    async def drip() -> None:
        while True:
            await asyncio.sleep(SOON_S / 10)
            writer.write(dripping)

    task = asyncio.create_task(drip())
    try:
        async with asyncio.timeout(60):
            while await reader.read(65_536):
                pass
    except ConnectionError:
        pass
    finally:
        task.cancel()
        writer.close()
    return time.monotonic() - began


@pytest.mark.parametrize(
    ("chunks", "dripping"),
    [
        ((), b""),
        ((), b"\r\n"),
        ((HALF,), b""),
        ((HALF,), b"a"),
        ((HALF,), b"a\r\nX-B: "),
        ((WHOLE,), b""),
        ((WHOLE,), b"\r\n"),
        ((WHOLE, HALF), b"a"),
        ((b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9999999\r\n\r\n",), b"a"),
    ],
)
async def test_who_never_finishes_a_request_is_let_go(port: int, chunks: tuple[bytes, ...], dripping: bytes) -> None:
    assert await closed_after(port, *chunks, dripping=dripping) >= SOON_S * 0.9


@pytest.mark.parametrize("port", [HeaderTimeoutProtocol], indirect=True)
async def test_headers_without_end_are_cut_off(port: int) -> None:
    assert await closed_after(port, HALF, *[b"a" * 8_192] * 100, dripping=b"a") < HEADERS_WITHIN_S


async def test_an_answer_that_takes_its_time_is_not_cut_off(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /slow HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    async with asyncio.timeout(60):
        assert (await reader.read()).count(b"1\r\nx\r\n") == 8
    writer.close()


async def test_a_websocket_that_is_quiet_stays_open(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(
        b"GET /ws HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n\r\n"
    )
    async with asyncio.timeout(60):
        assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
        await asyncio.sleep(SOON_S * 3)
        writer.write(b"\x81\x82\x00\x00\x00\x00hi")  # a text frame, masked with zeros
        assert b"still here" in await reader.read(100)
    writer.close()


def test_the_service_waits_fifteen_seconds() -> None:
    assert HeaderTimeoutProtocol.headers_within_s == HEADERS_WITHIN_S == 15.0
