"""What PostgreSQL itself refuses where several services share it: writes, claims and numbers."""

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest
from sqlalchemy import insert, select, text

from skyfolio.api.common.settings import Settings
from skyfolio.api.common.surroundings import Surroundings, surrounded
from skyfolio.api.flights.journal import Journal
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_store import Stores
from skyfolio.api.flights.ownership import Ownership
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.backend import EngineBackend
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.lease_book import Lease
from skyfolio.api.store.lease_table import LeaseTable
from skyfolio.api.store.leases import Leases
from skyfolio.api.store.spill import Spill
from skyfolio.api.store.tables import events, journal, operations
from skyfolio.api.store.tables import leases as leases_table
from skyfolio.api.store.writer import Statement

OPERATION = "operation-1"


def leases_of(url: str, name: str) -> Leases:
    return Leases.of(Settings(database_url=url, several_services=True, service_name=name, lease_s=60))


@pytest.fixture
async def pair(new_database: str) -> AsyncIterator[tuple[Database, Database]]:
    """Two services' databases; the first has the operation, with vehicles 1 and 2."""
    async with AsyncExitStack() as stack:
        made = [await Database.open(new_database, leases_of(new_database, name)) for name in ("first", "second")]
        for database in made:
            stack.push_async_callback(database.close)
            assert database.leases is not None
            stack.push_async_callback(database.leases.close)
        await claimed(made[0], OPERATION, {1, 2})
        yield made[0], made[1]


async def claimed(database: Database, operation_id: str, systems: set[int]) -> None:
    row = {"id": operation_id, "number": len(operation_id), "created_at": 0.0, "policy": "auto", "plan_id": "plan-1"}
    row |= {"state": "flying", "version": 1, "document": "{}"}
    leases = database.leases
    assert leases is not None
    began_s = leases.now_s()
    await database.write((insert(operations), row), *leases.claim(operation_id, systems))
    leases.claimed(operation_id, systems, began_s)


async def taken_over(by: Database) -> None:
    leases = by.leases
    assert leases is not None
    await leases.look()
    lease = leases.book.rows[OPERATION]
    token = await leases._table.take(lease)
    assert token == lease.token + 1


def step(number: int, operation_id: str = OPERATION) -> Statement:
    row = {"operation_id": operation_id, "at": float(number), "step": f"step-{number}", "incident": 1, "data": "{}"}
    return insert(journal), row


async def steps(database: Database) -> list[str]:
    return [row.step for row in await database.rows(select(journal.c.step).order_by(journal.c.at))]


async def test_the_writes_of_a_service_that_lost_an_operation_are_refused_whole(
    pair: tuple[Database, Database],
) -> None:
    first, second = pair
    await first.write(*first.owned(OPERATION), step(1))
    await taken_over(second)
    with pytest.raises(StoreError, match="belongs to another service"):
        await first.write(step(2), *first.owned(OPERATION))
    assert await steps(second) == ["step-1"]


async def test_nothing_is_written_under_a_lease_that_ran_out_though_nobody_took_it(
    pair: tuple[Database, Database],
) -> None:
    first, _ = pair
    assert first.leases is not None
    first.leases._clock = lambda: 1e12
    with pytest.raises(StoreError, match="belongs to another service"):
        await first.write(*first.owned(OPERATION), step(1))


async def test_what_was_held_in_a_file_is_stored_only_as_far_as_the_operation_was_not_taken_over(
    pair: tuple[Database, Database], new_database: str, tmp_path: Path
) -> None:
    first, second = pair
    spill = Spill(EngineBackend(new_database, shared_as="again").url, [tmp_path], "first")
    event = {"id": 1, "at": 5.0, "kind": "test", "data": "{}"}
    await spill.add([[*first.owned(OPERATION), step(1), step(2)], [(insert(events), event)]])
    await taken_over(second)
    backend = EngineBackend(new_database, shared_as="again")
    again = await Database.on(backend, spill)
    assert again.taken_up == 2
    assert await steps(again) == []
    assert [row.id for row in await again.rows(select(events.c.id))] == [1]
    await again.close()


async def test_what_was_held_in_a_file_is_stored_while_the_operation_is_still_ours(
    pair: tuple[Database, Database], new_database: str, tmp_path: Path
) -> None:
    first, _ = pair
    backend = EngineBackend(new_database, shared_as="again")
    spill = Spill(backend.url, [tmp_path], "first")
    await spill.add([[*first.owned(OPERATION), step(1)]])
    again = await Database.on(backend, spill)
    assert await steps(again) == ["step-1"]
    await again.close()


async def test_the_end_of_an_operation_that_was_taken_over_frees_no_vehicle(pair: tuple[Database, Database]) -> None:
    first, second = pair
    assert first.leases is not None
    await first.leases.look()
    await taken_over(second)
    stores = Stores(first, Journal(first), await EventLog.open(first))
    Ownership(stores, {}, _never, lambda _operation: None).end(OPERATION)
    await first.write(select(1))
    await asyncio.sleep(0)
    assert not first.leases.may_send(1)
    assert await second.rows(select(leases_table.c.token)) == [(2,)]


async def test_the_end_of_an_operation_frees_its_vehicles(pair: tuple[Database, Database]) -> None:
    first, second = pair
    assert first.leases is not None
    await first.leases.look()
    stores = Stores(first, Journal(first), await EventLog.open(first))
    Ownership(stores, {}, _never, lambda _operation: None).end(OPERATION)
    await first.write(select(1))
    await asyncio.sleep(0)
    assert first.leases.may_send(1)
    assert await second.rows(select(leases_table)) == []


async def _never(_row: object) -> Operation:
    raise AssertionError("nothing is taken over")


async def test_a_vehicle_is_claimed_by_one_operation_whichever_service_is_first(
    pair: tuple[Database, Database],
) -> None:
    _, second = pair
    with pytest.raises(StoreError, match="leased_vehicles"):  # it has not seen that the first has vehicle 2
        await claimed(second, "operation-of-second", {2, 3})
    assert await second.rows(select(operations.c.id).where(operations.c.id == "operation-of-second")) == []


async def test_events_of_two_services_have_one_row_of_numbers_without_a_gap(pair: tuple[Database, Database]) -> None:
    logs = [await EventLog.open(database) for database in pair]
    following = [asyncio.create_task(log.follow_others()) for log in logs]
    for number in range(150):
        for place, log in enumerate(logs):
            log.add("test", service=place, number=number)
        await asyncio.sleep(0)
    async with asyncio.timeout(60):
        while any(log.last_id < 300 for log in logs):  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    for log in logs:
        found = await log.after(0, limit=1000)
        assert [event.id for event in found] == list(range(1, 301))
        for place in (0, 1):
            assert [event.data["number"] for event in found if event.data["service"] == place] == list(range(150))
    for task in following:
        task.cancel()
    await asyncio.gather(*following, return_exceptions=True)


async def test_an_event_whose_commit_was_not_answered_is_stored_once(
    pair: tuple[Database, Database], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, _ = pair
    log, commit = await EventLog.open(first), first._writer._commit_all
    lost: list[list[Statement]] = []

    async def answer_lost(statements: list[Statement]) -> None:
        await commit(statements)
        if not lost:
            lost.append(statements)
            raise OSError("the connection is gone")

    monkeypatch.setattr(first._writer, "_commit_all", answer_lost)
    log.add("test", number=1)
    async with asyncio.timeout(60):
        while not lost or first.held or first.trouble is not None:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    log.add("test", number=2)
    await first.write(step(1))
    stored = await first.rows(select(events).order_by(events.c.id))
    assert [(row.id, json.loads(row.data)["number"]) for row in stored] == [(1, 1), (2, 2)]


async def test_services_that_share_a_database_and_one_that_does_not_exclude_each_other(new_database: str) -> None:
    shared = [await Database.open(new_database, leases_of(new_database, name)) for name in ("first", "second")]
    for database in shared:
        await database.claim()
    namesake = await Database.open(new_database, leases_of(new_database, "first"))
    with pytest.raises(StoreError, match="names that differ"):
        await namesake.claim()
    await namesake.close()
    alone = await Database.open(new_database)
    with pytest.raises(StoreError, match="several_services"):
        await alone.claim()
    for database in shared:
        await database.close()
    await alone.claim()
    late = await Database.open(new_database, leases_of(new_database, "third"))
    with pytest.raises(StoreError, match="several_services"):
        await late.claim()
    await late.close()
    await alone.close()


async def test_a_clock_that_differs_from_that_of_the_database_is_told_and_changes_no_lease(
    pair: tuple[Database, Database],
) -> None:
    first, _ = pair
    leases = first.leases
    assert leases is not None
    assert leases.state == "ok"
    for ahead_s, words in ((90.0, "s ahead of"), (-90.0, "s behind"), (0.0, "ok")):
        with surrounded(Surroundings(utc_s=lambda ahead_s=ahead_s: time.time() + ahead_s)):  # type: ignore[misc]
            await leases.look()
            assert words in leases.state
            assert leases.may_send(1)
            assert leases.require(OPERATION)[0][1] == {"operation_id": OPERATION, "token": 1}


async def test_a_service_that_was_stopped_in_a_transaction_holds_up_none_that_takes_over(
    pair: tuple[Database, Database],
) -> None:
    first, second = pair
    assert isinstance(first._backend, EngineBackend)
    async with first._backend.engine.connect() as stopped:
        await stopped.execute(text("SET LOCAL idle_in_transaction_session_timeout = 0"))
        await stopped.execute(text(f"SELECT pg_advisory_xact_lock({0x5C1F0112})"))  # it was about to add an event
        await taken_over(second)
        log = await EventLog.open(second)
        log.add("test", number=1)
        async with asyncio.timeout(60):
            await second.write(select(1))
        await stopped.invalidate()
    assert len(await second.rows(select(events))) == 1


async def test_a_database_that_does_not_answer_in_time_is_told_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    table = LeaseTable("postgresql+asyncpg://nobody@127.0.0.1:1/none", me="me", name="first", timeout_s=0.01)

    async def never() -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(table, "_connect", never)
    lease = Lease(operation_id="op", owner="", name="", token=1, beat=1, systems=frozenset())
    for asked in (table.look([]), table.take(lease), table.leave()):
        with pytest.raises(StoreError, match=r"^leases: TimeoutError$"):
            await asked
