"""The database, both kinds: migrations, durable writes that share commits, one service at a time."""

import asyncio
import os
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, insert, select
from sqlalchemy.ext.asyncio import create_async_engine

from skyfolio.api.store import Database, StoreError, metadata, migrate
from skyfolio.api.store.backend import EngineBackend
from skyfolio.api.store.tables import events

INSERT = insert(events)


def row(number: int) -> dict[str, object]:
    return {"id": number, "at": float(number), "kind": "test", "data": "{}"}


@pytest.fixture
async def database(database_url: str) -> AsyncIterator[Database]:
    made = await Database.open(database_url)
    yield made
    await made.close()


async def ids(database: Database) -> list[int]:
    return [found.id for found in await database.rows(select(events.c.id).order_by(events.c.id))]


async def test_migrations_lead_to_exactly_the_tables_of_this_version(database_url: str) -> None:
    await (await Database.open(database_url)).close()

    def differences(connection: Connection) -> list[object]:
        return list(compare_metadata(MigrationContext.configure(connection), metadata))

    engine = create_async_engine(database_url)
    async with engine.connect() as connection:
        assert await connection.run_sync(differences) == []
    await engine.dispose()


async def test_a_database_at_the_newest_revision_is_opened_without_alembic(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    await (await Database.open(database_url)).close()
    monkeypatch.setitem(sys.modules, "alembic", None)  # importing it fails
    await (await Database.open(database_url)).close()


def test_the_newest_revisions_are_those_that_alembic_finds() -> None:
    scripts = ScriptDirectory(str(Path(migrate.__file__).parent / "migrations"))
    assert migrate.newest_revisions() == set(scripts.get_heads())


async def test_a_database_that_is_closed_is_free_though_a_forked_process_holds_its_files(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path}/service.db"
    first = await Database.open(url)
    await first.claim()
    assert isinstance(first._backend, EngineBackend)
    assert first._backend.lock is not None
    with os.fdopen(os.dup(first._backend.lock.fileno())):  # as between fork and exec of a worker
        await first.close()
        second = await Database.open(url)
        await second.claim()
        await second.close()


async def test_what_was_written_is_there_after_opening_again(database_url: str) -> None:
    first = await Database.open(database_url)
    await first.write((INSERT, row(1)))
    await first.close()
    second = await Database.open(database_url)
    assert await ids(second) == [1]
    await second.close()


async def test_writes_that_come_together_all_become_durable_in_order(database: Database) -> None:
    done = [database.write_soon((INSERT, row(number))) for number in range(1, 1001)]
    await asyncio.gather(*done)
    assert await ids(database) == list(range(1, 1001))


async def test_a_write_that_is_refused_fails_alone(database: Database) -> None:
    good, twin, last = (database.write_soon((INSERT, row(number))) for number in (1, 1, 2))
    await good
    with pytest.raises(StoreError, match="write: "):
        await twin
    await last
    assert await ids(database) == [1, 2]


async def test_a_transaction_is_whole_or_not_at_all(database: Database) -> None:
    await database.write((INSERT, row(1)))
    with pytest.raises(StoreError):
        await database.write((INSERT, row(2)), (INSERT, row(1)))
    assert await ids(database) == [1]


async def test_closing_finishes_what_waits(database_url: str) -> None:
    first = await Database.open(database_url)
    for number in range(1, 101):
        first.write_soon((INSERT, row(number)))
    await first.close()
    second = await Database.open(database_url)
    assert len(await ids(second)) == 100
    await second.close()


async def test_two_services_cannot_have_the_same_database(database_url: str) -> None:
    first, second = await Database.open(database_url), await Database.open(database_url)
    await first.claim()
    with pytest.raises(StoreError, match="in use by another service"):
        await second.claim()
    await first.close()
    await second.close()
    third = await Database.open(database_url)
    await third.claim()
    await third.close()


@pytest.mark.parametrize(
    "url", ["sqlite:///x.db", "sqlite+aiosqlite://", "mysql://localhost/x", "nonsense", "postgresql://u:secret@h/d"]
)
async def test_a_url_that_cannot_be_used_is_refused_without_its_password(url: str) -> None:
    with pytest.raises(StoreError, match="database_url: ") as refused:
        await Database.open(url)
    assert "secret" not in str(refused.value)
