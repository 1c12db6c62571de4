"""The end of a stream: a caller waits for the vehicles that it needs, and never for one that is dead."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.setpoint_streams import SetpointStreams
from skyfolio.mavlink_bridge.guard import Orders
from skyfolio.mavlink_bridge.guidance import FallBack

SYSTEMS = {"uav-1": 1, "uav-2": 2}


class OneStream:
    """What `SetpointStreams` needs of a stream: uav-1 lets go after a moment, uav-2 is dead and never answers."""

    def __init__(self) -> None:
        self.dropped = False
        self.let_go: list[int] = []
        self.answers = asyncio.Event()
        self._handing: dict[int, asyncio.Task[str | None]] = {}

    async def run(self, _elapsed_s: Any) -> None:
        await asyncio.Event().wait()

    def hand_over(self, _elapsed_s: float) -> Mapping[int, asyncio.Task[str | None]]:
        if not self._handing:
            self._handing = {system: asyncio.create_task(self._let_go(system)) for system in (1, 2)}
        return self._handing

    def drop(self) -> None:
        self.dropped = True
        for task in self._handing.values():
            task.cancel()

    async def _let_go(self, system: int) -> str | None:
        await (self.answers.wait() if system == 1 else asyncio.Event().wait())
        self.let_go.append(system)
        return None


class Monitor:
    watched = frozenset({1, 2})

    def silent_for_s(self, system_id: int, _now_s: float) -> float:
        return 4.0 if system_id == 2 else 0.1


class NoFleet:
    links, signing_key_file = ("udpin://127.0.0.1:1",), None
    rights = SimpleNamespace(until_s=lambda _systems: None)

    class link:  # noqa: N801
        monitor = Monitor()


class OneGuard:
    """A guard that keeps its latest orders."""

    def __init__(self) -> None:
        self.latest: Orders | None = None

    def orders(self, orders: Orders | None) -> None:
        self.latest = orders

    async def close(self) -> None:
        self.latest = None


@asynccontextmanager
async def streaming() -> AsyncIterator[tuple[SetpointStreams, OneStream]]:
    fleet: Any = NoFleet()
    streams = SetpointStreams(SYSTEMS, fleet, FleetClock(1.0), elapsed_s=lambda: 7.0, fall_back=FallBack.MISSION)
    stream: Any = OneStream()
    streams._stream = stream
    streams.begin()
    yield streams, stream
    await streams.close()


async def is_waiting(task: asyncio.Task[None]) -> bool:
    for _ in range(10):
        await asyncio.sleep(0)
    return not task.done()


async def test_a_second_caller_waits_as_long_as_the_first() -> None:
    async with streaming() as (stream_to, stream):
        first, second = (asyncio.create_task(stream_to.end(["uav-1"])) for _ in range(2))
        assert await is_waiting(first)
        assert await is_waiting(second)
        stream.answers.set()
        await asyncio.gather(first, second)
        assert stream.let_go == [1]


@pytest.mark.parametrize("uavs", [["uav-1"], None], ids=["for one", "for all"])
async def test_nobody_waits_for_a_uav_that_is_not_heard(uavs: list[str] | None) -> None:
    async with streaming() as (stream_to, stream):
        stream.answers.set()
        async with asyncio.timeout(60):
            await stream_to.end(uavs)
        assert stream.let_go == [1]


async def test_a_stream_that_is_dropped_sends_nobody_onto_a_mission_and_waits_for_nobody() -> None:
    async with streaming() as (stream_to, stream):
        waiting = asyncio.create_task(stream_to.end(None))
        assert await is_waiting(waiting)
        stream_to.drop()
        assert stream.dropped
        async with asyncio.timeout(60):
            await waiting
            await stream_to.end(None)
        assert stream.let_go == []


async def test_the_guard_leaves_a_vehicle_alone_that_has_let_go_and_may_be_sent_another_mission() -> None:
    async with streaming() as (stream_to, stream):
        guard: Any = OneGuard()
        mission = SimpleNamespace(slot_of_item={2: 0, 4: 1}, item_of_slot=lambda slot: 2 + 2 * slot)
        assigned: Any = SimpleNamespace(first_slot=0, slot_s=5.0, path_m=[(0.0, 0.0), (0.0, 9.0)], mission=mission)
        stream_to._guard, stream_to._streamed = guard, {"uav-1": assigned, "uav-2": assigned}
        stream_to.renew_guard()
        assert guard.latest.items.keys() == {1, 2}
        stream.answers.set()
        await stream_to.end(["uav-1"])
        assert guard.latest.items.keys() == {2}
