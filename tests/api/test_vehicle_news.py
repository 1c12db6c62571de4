"""What the fleet reports of changes of its vehicles: each change once, with all that is known of it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.fleet.vehicle_news import FleetNews
from skyfolio.api.store.event_log import EventLog
from skyfolio.mavlink_bridge import FleetLink, LinkEvent, LinkState
from skyfolio.mavlink_bridge.conditions import Change, Condition, VehicleChange

LIVE, STALE, LOST = LinkState.LIVE, LinkState.STALE, LinkState.LOST


class Events:
    """An event log that only remembers."""

    def __init__(self) -> None:
        self.added: list[tuple[str, dict[str, Any]]] = []

    def add(self, kind: str, **data: Any) -> None:
        self.added.append((kind, data))


class Link:
    """A link that reports these changes, and then closes."""

    def __init__(self, *changes: VehicleChange) -> None:
        self._changes = changes
        self.speeds = self
        self.heard_systems: frozenset[int] = frozenset()

    async def changes(self) -> AsyncIterator[VehicleChange]:
        for change in self._changes:
            yield change

    async def ask_for_streams(self, _systems: object) -> None:
        pass

    def telemetry(self, _system_id: int) -> None:
        """Nothing is known of any vehicle."""


def link_step(before: LinkState, after: LinkState, silent_for_s: float = 5.25) -> LinkEvent:
    return LinkEvent(system_id=3, before=before, after=after, silent_for_s=silent_for_s, at_s=70.0)


def condition(before: Condition, after: Condition, cause: str) -> Change:
    return Change(system_id=3, before=before, after=after, cause=cause, at_s=70.0)


async def reported(*changes: VehicleChange) -> tuple[FleetNews, list[tuple[str, dict[str, Any]]], list[LinkEvent]]:
    """The news after these changes, the events that were added, and what followers were sent."""
    events = Events()
    news = FleetNews({"uav-3": 3}, cast("EventLog", events))
    queue = news.follow()
    background = Supervisor(lambda _kind, **_data: None)
    watching, *others = news.start(cast("FleetLink", Link(*changes)), background)
    await watching
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)
    await background.close()
    return news, events.added, [queue.get_nowait() for _ in range(queue.qsize())]


async def test_a_vehicle_that_falls_silent_is_reported_once_with_its_cause() -> None:
    step = link_step(STALE, LOST)
    lost = condition(Condition.STALE, Condition.LINK_LOST, "silent for 5.2 s, lost after 5 s")
    news, events, followed = await reported(VehicleChange(system_id=3, link=(step,), condition=lost))
    data = {"before": "stale", "after": "lost", "silent_for_s": 5.25, "cause": lost.cause}
    assert events == [("link", {"uav_id": "uav-3", **data})]
    assert followed == [step]
    assert news.changes[3] is lost


async def test_each_step_of_a_link_is_reported_and_the_last_has_the_cause() -> None:
    lost = condition(Condition.LIVE, Condition.AUTOPILOT_SILENT, "autopilot silent for 6.0 s, component 191 heard")
    steps = (link_step(LIVE, STALE), link_step(STALE, LOST, 6.0))
    _, events, followed = await reported(VehicleChange(system_id=3, link=steps, condition=lost))
    assert [(kind, data["after"], data["cause"]) for kind, data in events] == [
        ("link", "stale", None),
        ("link", "lost", lost.cause),
    ]
    assert followed == list(steps)


async def test_a_condition_that_says_more_than_the_link_is_reported_as_one() -> None:
    crashed = condition(Condition.LIVE, Condition.CRASHED, "sinking at 9.0 m/s")
    _, events, _ = await reported(VehicleChange(system_id=3, link=(link_step(LIVE, STALE),), condition=crashed))
    assert [kind for kind, _ in events] == ["link", "condition"]
    assert events[0][1]["cause"] is None
    assert events[1][1] == {"uav_id": "uav-3", "before": "live", "after": "crashed", "cause": "sinking at 9.0 m/s"}


async def test_a_companion_that_falls_silent_too_is_reported_although_the_link_was_lost_before() -> None:
    lost = condition(Condition.AUTOPILOT_SILENT, Condition.LINK_LOST, "silent for 9.0 s, lost after 5 s")
    _, events, _ = await reported(VehicleChange(system_id=3, condition=lost))
    assert [(kind, data["after"]) for kind, data in events] == [("condition", "link_lost")]


@pytest.mark.parametrize("after", [STALE, LOST])
async def test_the_link_of_a_crashed_vehicle_is_reported_without_a_condition(after: LinkState) -> None:
    _, events, _ = await reported(VehicleChange(system_id=3, link=(link_step(LIVE, after),)))
    assert [kind for kind, _ in events] == ["link"]


async def test_a_vehicle_that_is_not_registered_is_not_reported() -> None:
    stranger = VehicleChange(system_id=9, link=(link_step(LIVE, STALE),))
    news, events, followed = await reported(stranger)
    assert (events, followed, news.changes) == ([], [], {})
