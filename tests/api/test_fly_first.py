"""Fly first: what flights store outlives a database that does not answer, in order, in memory and in a file."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import insert, select
from sqlalchemy.exc import IntegrityError, OperationalError

from skyfolio.api.flights.journal import Entry, Journal, Step
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.backend import EngineBackend
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.spill import Spill
from skyfolio.api.store.tables import events, journal, operations
from skyfolio.api.store.writer import Statement, Writer, is_passing

INSERT = insert(events)
LOCKED = OperationalError("INSERT", {}, sqlite3.OperationalError("database is locked"))
FULL = OperationalError("INSERT", {}, sqlite3.OperationalError("database or disk is full"))


def row(number: int) -> dict[str, object]:
    return {"id": number, "at": float(number), "kind": "test", "data": "{}"}


class Disk:
    """Stands between a writer and its database: `error` is what each commit meets; `commits` counts them."""

    def __init__(self, writer: Writer) -> None:
        self.error: Exception | None = None
        self.commits = 0
        self._commit, writer._commit_all = writer._commit_all, self.commit

    async def commit(self, statements: list[Statement]) -> None:
        self.commits += 1
        if self.error is not None:
            raise self.error
        await self._commit(statements)


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite+aiosqlite:///{tmp_path}/service.db"


@pytest.fixture
async def database(url: str) -> AsyncIterator[Database]:
    made = await Database.open(url)
    yield made
    await made.close()


@pytest.fixture
def disk(database: Database) -> Iterator[Disk]:
    made = Disk(database._writer)
    yield made
    made.error = None


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def numbers(database: Database) -> list[int]:
    return [found.id for found in await database.rows(select(events.c.id).order_by(events.c.id))]


async def test_a_full_disk_holds_what_flights_store_in_order_and_refuses_clients(
    database: Database, disk: Disk
) -> None:
    disk.error = FULL
    async with asyncio.timeout(60):
        await database.keep((INSERT, row(1)))  # returns: the flight goes on
    assert str(database.trouble) == "database or disk is full"
    kept = [database.write_soon((INSERT, row(number)), keep=True) for number in (2, 3)]
    with pytest.raises(StoreError, match="disk is full"):
        await database.write((INSERT, row(9)))
    assert database.held == 3
    disk.error = None
    await asyncio.gather(*kept)
    assert not database.trouble
    assert await numbers(database) == [1, 2, 3]


async def test_a_commit_that_hangs_holds_up_a_flight_once_and_not_at_each_step(
    database: Database, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyfolio.api.store.writer.STUCK_AFTER_S", 0.05)
    go_on = asyncio.Event()
    commit = disk._commit

    async def hanging(statements: list[Statement]) -> None:
        await go_on.wait()
        await commit(statements)

    disk._commit = hanging
    await database.keep((INSERT, row(1)))
    waits = []
    for number in range(2, 12):
        kept = database.write_soon((INSERT, row(number)), keep=True)
        await database.kept(kept)
        waits.append(kept.done())
    assert waits == [False] * 10
    assert database.trouble is not None
    go_on.set()
    await kept
    assert await numbers(database) == list(range(1, 12))


def an_operation() -> Statement:
    operation = {"id": "op", "number": 1, "created_at": 0.0, "plan_id": "p", "policy": "auto", "state": "flying"}
    return insert(operations), {**operation, "version": 0, "document": "{}"}


async def killed(database: Database) -> None:
    """End it as SIGKILL does: nothing is finished."""
    writer = database._writer
    for task in (writer._task, writer._holding):
        if task is not None:
            task.cancel()
    assert isinstance(database._backend, EngineBackend)
    await database._backend.engine.dispose()


@pytest.mark.parametrize("is_carried_out", [False, True], ids=["never carried out", "carried out, and not answered"])
async def test_a_step_whose_commit_hangs_outlives_a_killed_service_once(
    database_url: str, monkeypatch: pytest.MonkeyPatch, is_carried_out: bool
) -> None:
    first = await Database.open(database_url)
    await first.write(an_operation())
    monkeypatch.setattr("skyfolio.api.store.writer.STUCK_AFTER_S", 0.05)
    disk = Disk(first._writer)
    commit = disk._commit

    async def hanging(statements: list[Statement]) -> None:
        if is_carried_out:
            await commit(statements)
        await asyncio.Event().wait()

    disk._commit = hanging
    books, at = Journal(first), datetime(2026, 1, 1, tzinfo=UTC)
    async with asyncio.timeout(60):
        for step in (Step.DETECTED, Step.UPLOADING):  # returns: the flight goes on
            await books.write(Entry(operation_id="op", incident=1, step=step, at=at, elapsed_s=0.1))
    await killed(first)
    second = await Database.open(database_url)
    assert [entry.step for entry in await Journal(second).of("op")] == [Step.DETECTED, Step.UPLOADING]
    await second.close()


async def test_a_step_that_comes_while_the_database_is_away_is_in_the_file_before_the_flight_goes_on(
    database: Database, disk: Disk, tmp_path: Path
) -> None:
    disk.error = FULL
    for number in range(1, 6):
        async with asyncio.timeout(60):
            await database.keep((INSERT, row(number)))
        assert len(held_in(tmp_path)) == number


async def test_the_file_is_kept_until_the_database_has_all_of_it(
    database: Database, disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyfolio.api.store.writer.MOST_AT_ONCE", 2)
    disk.error = FULL
    for number in range(1, 6):
        await database.keep((INSERT, row(number)))
    left: list[int] = []
    commit = disk._commit

    async def looking(statements: list[Statement]) -> None:
        left.append(len(held_in(tmp_path)))
        await commit(statements)

    disk._commit, disk.error = looking, None
    last = database.write_soon((INSERT, row(6)), keep=True)
    await last
    assert left == [6, 6, 6]  # the newer one as well: stored first, it would be undone by what is older
    await until(lambda: held_in(tmp_path) == [])
    assert await numbers(database) == list(range(1, 7))


async def test_a_killed_service_leaves_what_it_held_to_the_next_one(url: str, tmp_path: Path) -> None:
    first = await Database.open(url)
    await first.write(an_operation())
    disk = Disk(first._writer)
    disk.error = FULL
    books = Journal(first)
    at = datetime(2026, 1, 1, tzinfo=UTC)
    await books.write(Entry(operation_id="op", incident=1, step=Step.UPLOADING, at=at, data={"a": 'it\'s "é"'}))
    first.write_soon((INSERT, [row(1), row(2)]), keep=True)
    await until(lambda: len(held_in(tmp_path)) == 2)
    assert modes_in(tmp_path) == [0o600]
    await killed(first)
    second = await Database.open(url)
    assert second.taken_up == 2
    assert await numbers(second) == [1, 2]
    (found,) = await second.rows(select(journal))
    assert (found.step, found.data) == ("uploading", '{"a": "it\'s \\"\\u00e9\\""}')
    assert held_in(tmp_path) == []
    await second.close()


def held_in(folder: Path) -> list[str]:
    lines: list[str] = []
    for file in folder.glob("skyfolio-held-*"):
        with suppress(FileNotFoundError):  # it is removed as soon as all of it is stored
            lines += file.read_text().splitlines()
    return lines


def modes_in(folder: Path) -> list[int]:
    return [file.stat().st_mode & 0o777 for file in folder.glob("skyfolio-held-*")]


async def test_an_orderly_end_on_a_full_disk_loses_nothing(url: str) -> None:
    first = await Database.open(url)
    disk = Disk(first._writer)
    disk.error = LOCKED
    first.write_soon((INSERT, row(1)), keep=True)
    await first.close()
    second = await Database.open(url)
    assert await numbers(second) == [1]
    await second.close()


async def test_what_had_reached_the_database_is_not_stored_twice(url: str, tmp_path: Path) -> None:
    database = await Database.open(url)
    spill = Spill(database._backend.url, [tmp_path])
    await spill.add([[(INSERT, row(1))], [(INSERT, row(2))]])
    await database.write((INSERT, row(1)))
    await database.close()
    again = await Database.open(url)
    assert await numbers(again) == [1, 2]
    await again.close()


async def test_the_spill_goes_to_the_next_folder_where_the_first_takes_nothing(url: str, tmp_path: Path) -> None:
    database = await Database.open(url)
    spill = Spill(database._backend.url, [Path("/dev/null/no"), tmp_path / "b"])
    await spill.add([[(INSERT, row(1))]])
    assert str(spill.error).endswith("No such file or directory")  # neither folder is there
    (tmp_path / "b").mkdir()
    await spill.add([[(INSERT, row(1))]])
    assert spill.error is None
    assert len(list((tmp_path / "b").iterdir())) == 1
    await database.close()


async def test_an_event_that_waits_is_told_without_a_number_and_with_it_once_it_is_stored(
    database: Database, disk: Disk
) -> None:
    log = await EventLog.open(database)
    heard: asyncio.Queue[str] = asyncio.Queue()

    async def listen() -> None:
        async for wire in log.follow(0):
            for block in wire.decode().split("\n\n"):
                heard.put_nowait(block)

    listener = asyncio.create_task(listen())
    disk.error = FULL
    log.add("before")
    await until(lambda: database.trouble is not None)
    log.add("uav_lost", uav_id="uav-3")
    async with asyncio.timeout(60):
        early = await heard.get()
    assert "event: provisional" in early
    assert "id: " not in early.replace('"id": ', "")
    assert '"uav_lost"' in early
    disk.error = None
    told = ""
    async with asyncio.timeout(60):
        while "event: uav_lost" not in told:
            told += await heard.get()
    assert "id: 2" in told
    listener.cancel()
    await asyncio.gather(listener, return_exceptions=True)


@pytest.mark.parametrize(
    ("error", "passing"),
    [
        (LOCKED, True),
        (FULL, True),
        (OSError(28, "No space left on device"), True),
        (IntegrityError("INSERT", {}, sqlite3.IntegrityError("UNIQUE constraint failed")), False),
        (OperationalError("INSERT", {}, sqlite3.OperationalError("no such table: x")), False),
        (ValueError("not a row"), False),
    ],
)
def test_only_a_database_that_does_not_answer_is_worth_waiting_for(error: Exception, passing: bool) -> None:
    assert is_passing(error) is passing
