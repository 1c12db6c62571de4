"""Pauses of our own: a blocked event loop is not the fleet's silence, and hides no loss for good."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

import pytest

from skyfolio.mavlink_bridge import AUTOPILOT, HeartbeatMonitor, LinkEvent, LinkState
from skyfolio.mavlink_bridge.framing import Frame, Framer, is_foreign_heartbeat
from skyfolio.mavlink_bridge.listening import ListeningLink
from skyfolio.mavlink_bridge.pauses import POLL_S, STALL_S
from tests.recordings.reading import messages

LOST_AFTER_S = 1.5
PAUSE_S = 3.0


class Wall:
    def now(self) -> float:
        return time.monotonic()


@pytest.fixture
async def link() -> AsyncIterator[ListeningLink]:
    monitor = HeartbeatMonitor(stale_after_s=LOST_AFTER_S / 2, lost_after_s=LOST_AFTER_S, recovered_after_s=0.5)
    async with ListeningLink(clock=Wall(), monitor=monitor) as link:
        link.classifier.watch(1, time.monotonic())
        yield link


async def beat(link: ListeningLink) -> None:
    """A vehicle that is heard ten times a second, whenever we listen."""
    frame = Frame(b"", 1, AUTOPILOT, 33, 0, 2, False)
    while True:
        link._frame_heard(frame)
        await asyncio.sleep(POLL_S)


async def collect(link: ListeningLink, into: list[LinkEvent]) -> None:
    async for change in link.changes():
        into += change.link


async def test_a_blocked_event_loop_loses_nobody(link: ListeningLink) -> None:
    events: list[LinkEvent] = []
    tasks = [asyncio.create_task(beat(link)), asyncio.create_task(collect(link, events))]
    await asyncio.sleep(3 * POLL_S)
    time.sleep(PAUSE_S)  # noqa: ASYNC251 - that is the pause
    await asyncio.sleep(6 * POLL_S)
    for task in tasks:
        task.cancel()
    assert [event.after for event in events] == []


async def test_a_loss_is_found_however_often_the_event_loop_is_blocked(link: ListeningLink) -> None:
    events: list[LinkEvent] = []
    task = asyncio.create_task(collect(link, events))
    began_s = time.monotonic()
    pauses = 0
    while not any(event.after is LinkState.LOST for event in events):
        time.sleep(STALL_S + 2 * POLL_S)  # noqa: ASYNC251 - each look is late
        await asyncio.sleep(1.5 * POLL_S)
        pauses += 1
        assert pauses < 30, f"no loss after {time.monotonic() - began_s:.1f} s"
    task.cancel()


def test_a_foreign_heartbeat_is_known_by_its_bytes() -> None:
    heard = [one for one in messages("ccc-human-stop") if one.name == "HEARTBEAT"]
    told = {(one.system_id, is_foreign_heartbeat(Framer().feed(one.frame)[0])) for one in heard}
    assert told == {(1, False), (2, False), (3, False), (245, False), (255, False)}  # stations do not claim component 1


def test_a_heartbeat_cut_short_is_read_as_zeros_behind_it() -> None:
    assert not is_foreign_heartbeat(Frame(bytes([0xFD, 0, 0, 0, 0, 1, 1, 0, 0, 0, 6, 8]), 1, 1, 0, 0, 2, False))


def test_a_companions_heartbeat_is_its_own_and_not_foreign() -> None:
    companion = Frame(bytes([0xFD, 6, 0, 0, 0, 1, 191, 0, 0, 0, 0, 0, 0, 0, 18, 8]), 1, 191, 0, 0, 2, False)
    assert not is_foreign_heartbeat(companion)
    assert is_foreign_heartbeat(companion._replace(component_id=1))
