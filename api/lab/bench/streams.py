"""Event streams under load: many subscribers, telemetry of many UAVs, and events that must all arrive."""

from __future__ import annotations

import asyncio
import json
import socket
import tempfile
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias

import httpx2

from skyfolio import sim
from skyfolio.api.lab.bench.measure import quantile
from skyfolio.api.lab.demo.client import DemoError, call, free_port, service_process

SUBSCRIBERS = 100
READ_BYTES = 1 << 16
TIMED = 10
"""Subscribers that note how late events arrive; to do so for all would take this process too long."""
GRACE_S = 10.0
"""Events that are under way at the end have so long to arrive."""
LOOK_S = 0.05
Stream: TypeAlias = tuple[asyncio.StreamReader, asyncio.StreamWriter]


@dataclass(frozen=True, kw_only=True)
class Listening:
    """What is to be heard: telemetry of so many vehicles, and so many events, within so many seconds."""

    vehicles: int = 50
    for_s: float = 20.0
    events: int = 300


@dataclass
class Heard:
    """What one subscriber received. timed: whether it notes how late events arrive."""

    timed: bool = False
    events: list[int] = field(default_factory=list)
    pictures: int = 0
    largest_gap_s: float = 0.0
    delays_s: list[float] = field(default_factory=list)
    """Of events that happened while it listened."""


async def streams_figures(listening: Listening = Listening(), subscribers: int = SUBSCRIBERS) -> dict[str, Any]:
    """Run subscribers at 10 Hz telemetry of many UAVs while events happen; report what was missed."""
    endpoint = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    fleet = sim.Fleet(
        sim.grid_of(listening.vehicles, 47.397742, 8.545594), clock=sim.ScaledClock(), endpoint=f"udpout://{endpoint}"
    )
    async with AsyncExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        log, most = Path(folder) / "service.log", {"SKYFOLIO_MAX_SUBSCRIBERS": str(subscribers)}
        client = await stack.enter_async_context(service_process(1.0, f"udpin://{endpoint}", log, most))
        await stack.enter_async_context(fleet)
        for number in range(1, listening.vehicles + 1):
            await call(client, "POST", "/v1/fleet/vehicles", json={"uav_id": f"uav-{number}", "system_id": number})
        port = client.base_url.port or 80
        streams = await asyncio.gather(*(_opened(port) for _ in range(subscribers)))
        before, began = await process_figures(client), time.monotonic()
        heard = [Heard(timed=number < TIMED) for number in range(subscribers)]
        hearing = [asyncio.create_task(_listen(*pair)) for pair in zip(streams, heard, strict=True)]
        await _make_events(client, began, listening)
        await asyncio.sleep(max(0.0, began + listening.for_s - time.monotonic()))
        after, seconds = await process_figures(client), time.monotonic() - began
        last_id = await _last_event(client)
        await _all_heard(heard, last_id)
        for task in hearing:
            task.cancel()
        await asyncio.gather(*hearing, return_exceptions=True)
    share = (after["cpu_s"] - before["cpu_s"]) / seconds
    return {**_summary(heard, last_id, seconds, listening), "share_of_one_core": share, "memory_mb": after["memory_mb"]}


async def process_figures(client: httpx2.AsyncClient) -> dict[str, float]:
    """Return the processor seconds and the memory of the service's own process, as its metrics say."""
    lines = [
        line.split(" ") for line in (await client.get("/metrics")).text.splitlines() if line.startswith("process_")
    ]
    figures = {name: float(value) for name, value in lines}
    return {
        "cpu_s": figures["process_cpu_seconds_total"],
        "memory_mb": figures["process_resident_memory_bytes"] / 2**20,
    }


async def _all_heard(heard: list[Heard], last_id: int) -> None:
    """Wait until every subscriber has received the last event, but not for ever."""
    for _ in range(int(GRACE_S / LOOK_S)):
        if all(last_id in one.events[-1:] for one in heard):
            return
        await asyncio.sleep(LOOK_S)


def _summary(heard: list[Heard], last_id: int, seconds: float, listening: Listening) -> dict[str, Any]:
    delays_s = [delay for one in heard for delay in one.delays_s]
    expected = set(range(1, last_id + 1))
    return {
        "subscribers": len(heard),
        "vehicles": listening.vehicles,
        "seconds": seconds,
        "events": last_id,
        "events_lost": sum(len(expected - set(subscriber.events)) for subscriber in heard),
        "out_of_order": sum(subscriber.events != sorted(subscriber.events) for subscriber in heard),
        "event_delay_p99_s": quantile(delays_s, 0.99) if delays_s else None,
        "pictures_per_s_least": min(subscriber.pictures for subscriber in heard) / seconds,
        "pictures_per_s_mean": sum(subscriber.pictures for subscriber in heard) / len(heard) / seconds,
        "largest_gap_s": max(subscriber.largest_gap_s for subscriber in heard),
    }


async def _make_events(client: httpx2.AsyncClient, began: float, listening: Listening) -> None:
    """Events at a steady pace: vehicles come and go."""
    pace_s = listening.for_s * 0.8 / (listening.events // 2)
    for number in range(listening.events // 2):
        await asyncio.sleep(max(0.0, began + 0.05 * listening.for_s + number * pace_s - time.monotonic()))
        await call(client, "POST", "/v1/fleet/vehicles", json={"uav_id": "guest", "system_id": 200})
        (await client.delete("/v1/fleet/vehicles/guest")).raise_for_status()


async def _last_event(client: httpx2.AsyncClient) -> int:
    last = 0
    while True:
        page = await call(client, "GET", "/v1/events/log", params={"after": last, "limit": 500})
        if not page["items"]:
            return last
        last = page["items"][-1]["id"]


async def _opened(port: int) -> Stream:
    """Open a stream of events and telemetry, past its head."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 22)
    writer.write(b"GET /v1/events?telemetry=true HTTP/1.1\r\nHost: localhost\r\n\r\n")
    head = await reader.readuntil(b"\r\n\r\n")
    if b" 200 " not in head.splitlines()[0]:
        raise DemoError(f"GET /v1/events: {head.splitlines()[0].decode()}")
    return reader, writer


async def _listen(stream: Stream, heard: Heard) -> None:
    """Run a subscriber as lean as can be, until it is cancelled: this process has to feed hundreds of them."""
    reader, writer = stream
    began = last = time.monotonic()
    rest = b""
    try:
        while chunk := await reader.read(READ_BYTES):
            *whole, rest = (rest + chunk).split(b"\n\n")
            pictures = sum(b"event: telemetry" in block for block in whole)
            numbered = [block for block in whole if b"\nid: " in block]
            heard.events += [_id_of(block) for block in numbered]
            if heard.timed:
                heard.delays_s += [delay for block in numbered if (delay := _delay_s(block)) < time.monotonic() - began]
            if pictures:
                now = time.monotonic()
                heard.pictures += pictures
                heard.largest_gap_s = max(heard.largest_gap_s, now - last)
                last = now
    finally:
        writer.close()


def _delay_s(block: bytes) -> float:
    """Return how long ago the event of a block happened, seconds."""
    data = next(line for line in block.splitlines() if line.startswith(b"data: "))
    happened = datetime.fromisoformat(json.loads(data.removeprefix(b"data: "))["at"])
    return (datetime.now(UTC) - happened).total_seconds()


def _id_of(block: bytes) -> int:
    number: int = json.loads(block.rsplit(b"\nid: ", 1)[1].split(b"\r", 1)[0])
    return number
