"""The event log: stored before heard, resumed after any number, slow readers lose telemetry and nothing else."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from skyfolio.api.store import Database
from skyfolio.api.store import event_log as module
from skyfolio.api.store.event_log import EventLog


@pytest.fixture
async def log(database_url: str) -> AsyncIterator[EventLog]:
    database = await Database.open(database_url)
    yield await EventLog.open(database)
    await database.close()


def ids(wire: bytes) -> list[int]:
    return [int(line[4:]) for line in wire.decode().splitlines() if line.startswith("id: ")]


async def stored(log: EventLog, last: int) -> None:
    while log.last_id < last:  # noqa: ASYNC110
        await asyncio.sleep(0)


async def all_of(log: EventLog, last_id: int = 0) -> list[int]:
    return [number async for wire in log.follow(last_id, forever=False) for number in ids(wire)]


async def test_a_client_resumes_after_any_number(log: EventLog) -> None:
    for number in range(20):
        log.add("test", number=number)
    await stored(log, 20)
    assert await all_of(log) == list(range(1, 21))
    assert await all_of(log, 7) == list(range(8, 21))
    assert await all_of(log, 20) == []
    assert await all_of(log, 99) == []


async def test_numbers_go_on_after_a_restart_and_old_events_are_still_told(database_url: str) -> None:
    for first in (1, 11):
        database = await Database.open(database_url)
        log = await EventLog.open(database)
        assert [log.add("test").id for _ in range(10)] == list(range(first, first + 10))
        await stored(log, first + 9)
        assert await all_of(log) == list(range(1, first + 10))
        await database.close()


async def test_a_reader_that_sleeps_through_more_than_memory_holds_still_gets_every_event(
    log: EventLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log, "_recent", type(log._recent)(maxlen=16))
    reader = log.follow(telemetry=True)
    log.add("test")
    heard = ids(await anext(reader))
    for number in range(2000):
        log.add("test", number=number)
        log.publish_telemetry({"number": number})
    await stored(log, 2001)
    pictures = 0
    while len(heard) < 2001:
        wire = await anext(reader)
        heard += ids(wire)
        pictures += wire.count(b"event: telemetry")
    assert heard == list(range(1, 2002))
    assert pictures <= module.KEEP_TELEMETRY
    await reader.aclose()  # type: ignore[attr-defined]
    assert log.followers == 0


async def test_telemetry_is_only_for_those_who_ask_and_has_no_number(log: EventLog) -> None:
    with_pictures, without = log.follow(telemetry=True), log.follow()
    first, second = asyncio.ensure_future(anext(with_pictures)), asyncio.ensure_future(anext(without))
    await asyncio.sleep(0)
    log.publish_telemetry({"vehicles": []})
    assert await first == b'event: telemetry\ndata: {"vehicles":[]}\n\n'
    log.add("test")
    assert ids(await second) == [1]


async def test_an_event_that_cannot_be_stored_is_still_told(log: EventLog) -> None:
    log.add("test")
    await stored(log, 1)
    refused = asyncio.Event()
    log.listeners.append(lambda event: refused.set() if event.kind == "again" else None)
    log._last_id = 0  # the next number is taken: the database refuses
    log.add("again")
    async with asyncio.timeout(60):
        await refused.wait()
    told = log.follow(0, forever=False)
    assert b"event: again" in b"".join([wire async for wire in told])
