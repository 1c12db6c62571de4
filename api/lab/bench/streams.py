"""Event streams under load: many subscribers, telemetry of many UAVs, and events that must all arrive."""

from __future__ import annotations

import asyncio
import json
import socket
import tempfile
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2

from skyfolio import sim
from skyfolio.api.lab.demo.client import call, free_port, service_process

SUBSCRIBERS = 100
VEHICLES = 50
FOR_S = 20.0
EVENTS = 300
READ_BYTES = 1 << 16


@dataclass
class Heard:
    """What one subscriber received."""

    events: list[int] = field(default_factory=list)
    pictures: int = 0
    largest_gap_s: float = 0.0


async def streams_figures() -> dict[str, Any]:
    """Run a hundred subscribers at 10 Hz telemetry of fifty UAVs, while events happen; report what was missed."""
    endpoint = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    fleet = sim.Fleet(
        sim.grid_of(VEHICLES, 47.397742, 8.545594), clock=sim.ScaledClock(), endpoint=f"udpout://{endpoint}"
    )
    async with AsyncExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        log = Path(folder) / "service.log"
        client = await stack.enter_async_context(service_process(1.0, f"udpin://{endpoint}", log))
        await stack.enter_async_context(fleet)
        for number in range(1, VEHICLES + 1):
            await call(client, "POST", "/v1/fleet/vehicles", json={"uav_id": f"uav-{number}", "system_id": number})
        port = client.base_url.port or 80
        began = time.monotonic()
        listening = [asyncio.create_task(_listen(port, began + FOR_S)) for _ in range(SUBSCRIBERS)]
        await _make_events(client, began)
        heard = await asyncio.gather(*listening)
        last_id = await _last_event(client)
    return _summary(heard, last_id)


def _summary(heard: list[Heard], last_id: int) -> dict[str, Any]:
    expected = set(range(1, last_id + 1))
    return {
        "subscribers": SUBSCRIBERS,
        "vehicles": VEHICLES,
        "seconds": FOR_S,
        "events": last_id,
        "events_lost": sum(len(expected - set(subscriber.events)) for subscriber in heard),
        "out_of_order": sum(subscriber.events != sorted(subscriber.events) for subscriber in heard),
        "pictures_per_s_least": min(subscriber.pictures for subscriber in heard) / FOR_S,
        "pictures_per_s_mean": sum(subscriber.pictures for subscriber in heard) / len(heard) / FOR_S,
        "largest_gap_s": max(subscriber.largest_gap_s for subscriber in heard),
    }


async def _make_events(client: httpx2.AsyncClient, began: float) -> None:
    """Events at a steady pace: vehicles come and go."""
    for number in range(EVENTS // 2):
        await asyncio.sleep(max(0.0, began + 1 + number * (FOR_S - 4) / (EVENTS // 2) - time.monotonic()))
        await call(client, "POST", "/v1/fleet/vehicles", json={"uav_id": "guest", "system_id": 200})
        (await client.delete("/v1/fleet/vehicles/guest")).raise_for_status()


async def _last_event(client: httpx2.AsyncClient) -> int:
    last = 0
    while True:
        page = await call(client, "GET", "/v1/events/log", params={"after": last, "limit": 500})
        if not page["items"]:
            return last
        last = page["items"][-1]["id"]


async def _listen(port: int, until: float) -> Heard:
    """Run a subscriber as lean as can be: this process has to feed a hundred of them."""
    heard = Heard()
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 22)
    writer.write(b"GET /v1/events?telemetry=true HTTP/1.1\r\nHost: localhost\r\n\r\n")
    await reader.readuntil(b"\r\n\r\n")
    last, rest = time.monotonic(), b""
    try:
        async with asyncio.timeout(until - time.monotonic()):
            while chunk := await reader.read(READ_BYTES):
                *whole, rest = (rest + chunk).split(b"\n\n")
                pictures = sum(b"event: telemetry" in block for block in whole)
                heard.events += [_id_of(block) for block in whole if b"\nid: " in block]
                if pictures:
                    now = time.monotonic()
                    heard.pictures += pictures
                    heard.largest_gap_s = max(heard.largest_gap_s, now - last)
                    last = now
    except TimeoutError:
        pass
    finally:
        writer.close()
    return heard


def _id_of(block: bytes) -> int:
    number: int = json.loads(block.rsplit(b"\nid: ", 1)[1].split(b"\r", 1)[0])
    return number
