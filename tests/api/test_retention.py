"""What is forgotten and when; that the database does not grow without end, and that nobody else can read it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import func, insert, select

from skyfolio.api.access.audit_log import MOST_CLIENTS, REFUSALS_A_MINUTE, AuditLog
from skyfolio.api.common.settings import Settings
from skyfolio.api.store import Database
from skyfolio.api.store.retention import Retention
from skyfolio.api.store.tables import audit, events, journal, operations, plans, track

DAY_S = 86_400.0
NOW = 1_000 * DAY_S
SETTINGS = Settings(
    keep_ended_s=7 * DAY_S, keep_operations_s=30 * DAY_S, keep_events_s=10 * DAY_S, keep_events=50, keep_audit=20
)


@pytest.fixture
async def database(database_url: str) -> AsyncIterator[Database]:
    made = await Database.open(database_url)
    yield made
    await made.close()


async def count(database: Database, table: Any) -> int:
    return int((await database.rows(select(func.count()).select_from(table)))[0][0])


async def forget_nothing(before: float) -> int:
    del before
    return 0


def audited(status: int, client: str = "10.0.0.1") -> dict[str, Any]:
    said = {"at": NOW, "principal": "nobody", "role": "none", "client": client, "method": "POST"}
    return {**said, "path": "/v1/plans", "status": status, "request_id": "r"}


async def test_events_go_by_age_and_by_number(database: Database) -> None:
    rows = [{"id": n, "at": NOW - (11 if n <= 30 else 1) * DAY_S, "kind": "test", "data": "{}"} for n in range(1, 101)]
    await database.write((insert(events), rows))
    gone = await Retention(database, SETTINGS, wall_s=lambda: NOW).tidy(forget_nothing)
    assert gone["events"] == 50
    assert (await database.rows(select(func.min(events.c.id))))[0][0] == 51


async def test_an_old_operation_goes_with_all_that_belongs_to_it_and_a_young_one_stays(database: Database) -> None:
    for number, (name, ended) in enumerate({"old": NOW - 31 * DAY_S, "young": NOW - DAY_S, "flying": None}.items()):
        plan = {"id": f"plan-{name}", "number": number, "created_at": 0.0, "owner": "", "status": "succeeded"}
        plan |= {"revision": 1, "cause": "{}", "scenario": "{}", "operation_id": name, "ended_at": 1.0}
        operation = {"id": name, "number": number, "created_at": 0.0, "ended_at": ended, "plan_id": plan["id"]}
        operation |= {"policy": "auto", "state": "completed" if ended else "flying", "version": 0, "document": "{}"}
        await database.write(
            (insert(plans), plan),
            (insert(operations), operation),
            (insert(journal), {"operation_id": name, "incident": 1, "step": "closed", "at": 0.0, "data": "{}"}),
            (insert(track), {"operation_id": name, "elapsed_s": 0.0, "positions": "{}"}),
        )
    gone = await Retention(database, SETTINGS, wall_s=lambda: NOW).tidy(forget_nothing)
    assert gone["operations"] == 1
    for table in (operations, plans, journal, track):
        assert await count(database, table) == 2


async def test_refusals_of_one_address_are_counted_beyond_some_a_minute(database: Database) -> None:
    clock = [0.0]
    trail = AuditLog(database, now_s=lambda: clock[0])
    for _ in range(3_522):
        trail.write(audited(401))
    trail.write(audited(202))
    trail.write(audited(401, client="10.0.0.2"))
    clock[0] = 61.0
    trail.write(audited(401))
    await database.write()
    rows = await database.rows(select(audit).order_by(audit.c.id))
    assert [row.status for row in rows].count(401) == REFUSALS_A_MINUTE + 2
    assert rows[-1].path == f"(after {3_522 - REFUSALS_A_MINUTE} more refusals) /v1/plans"


async def test_many_addresses_cost_bounded_memory(database: Database) -> None:
    trail = AuditLog(database, now_s=lambda: 0.0)
    for number in range(2 * MOST_CLIENTS):
        trail._refused(f"address {number}")
    assert len(trail._minutes) == MOST_CLIENTS


async def test_the_file_of_a_database_is_its_owners_and_gives_space_back(tmp_path: Path) -> None:
    file = tmp_path / "new" / "service.db"
    made = await Database.open(f"sqlite+aiosqlite:///{file}")
    await made.claim()
    rows = [{"id": n, "at": 1.0, "kind": "test", "data": "x" * 2_000} for n in range(1, 1_001)]
    await made.write((insert(events), rows))
    modes = {one.name: one.stat().st_mode & 0o077 for one in file.parent.iterdir()}
    assert set(modes.values()) == {0}, modes
    pages = (await made.rows(select(func.count()).select_from(func.pragma_page_count())))[0][0]
    assert pages == 1
    before = await _pages(made)
    await Retention(made, SETTINGS, wall_s=lambda: NOW).tidy(forget_nothing)
    assert await _pages(made) < before / 2
    await made.close()


async def _pages(database: Database) -> int:
    from sqlalchemy import text  # noqa: PLC0415

    return int((await database.rows(text("PRAGMA page_count")))[0][0])
