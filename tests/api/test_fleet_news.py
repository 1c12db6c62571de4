"""Which vehicles are asked for telemetry, and when anew."""

import asyncio
from collections.abc import AsyncIterator, Iterable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.fleet.vehicle_news import FleetNews
from skyfolio.api.store.event_log import EventLog
from skyfolio.mavlink_bridge import FleetLink, LinkEvent, LinkState
from skyfolio.mavlink_bridge.conditions import VehicleChange
from tests.virtual_time import in_virtual_time


class Link:
    """A link on which one vehicle comes and goes."""

    def __init__(self) -> None:
        self.speeds = self
        self.tell: Any = None
        self.asked: list[int] = []
        self.here = True
        self.armed = True
        self.changed: asyncio.Queue[VehicleChange] = asyncio.Queue()

    heard_systems = frozenset({1})
    """Those that were ever heard."""

    def is_heard(self, system_id: int) -> bool:
        return self.here and system_id == 1

    def telemetry(self, _system_id: int) -> Any:
        return SimpleNamespace(armed=self.armed)

    async def ask_for_streams(self, system_ids: Iterable[int]) -> None:
        self.asked += system_ids

    async def changes(self) -> AsyncIterator[VehicleChange]:
        while True:
            yield await self.changed.get()

    def become(self, after: LinkState) -> None:
        self.here = after is not LinkState.LOST
        step = LinkEvent(system_id=1, before=LinkState.STALE, after=after, silent_for_s=6.0, at_s=0.0)
        self.changed.put_nowait(VehicleChange(system_id=1, link=(step,)))


class Events:
    def add(self, _kind: str, **_data: Any) -> None:
        """Keep none of them."""


@in_virtual_time
async def test_a_vehicle_that_was_lost_is_asked_for_its_telemetry_anew_when_it_is_heard_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("skyfolio.api.fleet.vehicle_news.ASK_EVERY_S", 0.01)
    link, events = Link(), Events()
    news = FleetNews({"uav-1": 1, "uav-2": 2}, cast("EventLog", events))
    tasks = news.start(cast("FleetLink", link), Supervisor(events.add))

    async def look() -> list[int]:
        await asyncio.sleep(0.05)
        asked, link.asked = link.asked, []
        return asked

    assert await look() == [1]
    assert await look() == []
    link.become(LinkState.LOST)
    assert await look() == []  # no vehicle is there to be asked
    link.become(LinkState.STALE)
    assert await look() == [1]
    link.become(LinkState.LIVE)
    assert await look() == []
    link.armed = False
    link.become(LinkState.LIVE)
    assert await look() == [1], "one on the ground may have restarted in a silence that was too short for a loss"
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
