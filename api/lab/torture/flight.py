"""Flies one drill, and returns what was broken."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field

from sqlalchemy import select

from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.journal import Entry, entry_of
from skyfolio.api.flights.operation_views import ENDED, OperationView, State
from skyfolio.api.lab.torture.blows import Arena
from skyfolio.api.lab.torture.drill import Drill
from skyfolio.api.lab.torture.invariants import AFTERWARDS, AT_END, MEANWHILE, look
from skyfolio.api.lab.torture.triggers import Triggers
from skyfolio.api.lab.torture.watch import Seen, files_open_now
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import run
from skyfolio.api.service import Service
from skyfolio.api.store.event_log import Event
from skyfolio.api.store.tables import journal as journal_table

LOOK_S = 0.5
AFTERMATH_S = 2.0
STUCK_S = 60.0
"""An operation that waits for its operator so long is aborted by them: paused, or interrupted by a restart."""
LIMIT_S = 700.0
"""Fleet seconds beside the plan's in which an operation must have ended."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a drill. broken: detail by invariant. coverage: (state, blow) of every blow that struck."""

    drill: Drill
    broken: dict[str, str]
    state: str
    coverage: Counter[tuple[str, str]]
    virtual_s: float
    wall_s: float
    events: list[Event] = field(default_factory=list)
    blows: list[str] = field(default_factory=list)


def fly(drill: Drill) -> Outcome:
    """Fly a drill from the first start of the service to its end."""
    began_s = time.perf_counter()
    seen, virtual_s = run(_fly(drill))
    return Outcome(
        drill=drill,
        broken=dict(sorted(seen.broken.items())),
        state="none" if seen.end is None else seen.end.state.value,
        coverage=seen.coverage,
        virtual_s=virtual_s,
        wall_s=time.perf_counter() - began_s,
        events=seen.events,
        blows=[f"{one.at_s:.2f} s, {one.state}: {one.blow}" for one in seen.struck],
    )


async def _fly(drill: Drill) -> Seen:
    files_open = files_open_now()
    async with drill.ground() as ground:
        seen = Seen(drill, ground, files_open=[files_open])
        arena = Arena(seen)
        triggers = Triggers(arena, drill.blows)
        ground.on_event = triggers.note
        ground.fleet.truth.on_received = lambda at_s, system_id, message: seen.received.append(
            (at_s, system_id, message)
        )
        triggers.follow(await ground.start())
        seen.operation_id = await _begun(ground, drill, seen)
        triggers.begin()
        await _until_ended(seen, arena)
        await asyncio.sleep(AFTERMATH_S)
        while arena.tasks:
            await asyncio.wait(list(arena.tasks))
        seen.look_into_memory()
        await ground.stop()
        seen.events, seen.journal = ground.stored_events(), _journal(ground)
        seen.note_reports(seen.end.recoveries if seen.end is not None else ())
        look(seen, AT_END)
    seen.files_open.append(files_open_now())
    look(seen, AFTERWARDS)
    return seen


async def _begun(ground: Ground, drill: Drill, seen: Seen) -> str:
    service = ground.service
    assert service is not None  # noqa: S101 - it was just started
    await ground.register()
    record = await ground.ask(service.plans.submit(ground.scenario, fresh("plan")))
    await ground.ask(service.plans.wait(record, 60.0))
    creation = fresh("operation")
    seen.operation_id = creation.id
    operation = await ground.ask(service.operations.start(record.id, drill.policy, creation))
    return operation.id


async def _until_ended(seen: Seen, arena: Arena) -> None:
    """Look again and again until the operation has ended; see to one that waits for its operator."""
    ground, scenario = seen.ground, seen.ground.scenario
    limit_s = ground.now_s + scenario.slots * scenario.slot_duration_s + LIMIT_S
    waits_since_s: float | None = None
    while ground.now_s < limit_s:
        await asyncio.sleep(LOOK_S)
        seen.follow_truth()
        seen.excuse(LOOK_S, down=arena.down)
        seen.follow_operation()
        look(seen, MEANWHILE)
        seen.received.clear()
        seen.news.clear()
        view = await _view(seen, arena)
        if view is None:
            continue
        seen.end = view
        if view.state in ENDED:
            return
        waits = view.state in {State.PAUSED, State.INTERRUPTED}
        waits_since_s = (waits_since_s or ground.now_s) if waits else None
        if waits_since_s is not None and ground.now_s - waits_since_s >= STUCK_S:
            waits_since_s = None
            arena.note_orders()
            arena.command(lambda service: service.operations.abort(seen.operation_id, "land"))


async def _view(seen: Seen, arena: Arena) -> OperationView | None:
    """Return the operation as its service shows it; None while there is none, or it does not answer."""
    service: Service | None = seen.ground.service
    if service is None or arena.down or seen.ground.disk.refuses is not None:
        return None
    try:
        async with asyncio.timeout(5.0):
            return await seen.ground.ask(service.operations.view(seen.operation_id))
    except TimeoutError:
        return None
    except asyncio.CancelledError:
        if seen.ground.service is service:
            raise
        return None  # it was killed meanwhile


def _journal(ground: Ground) -> list[Entry]:
    with ground.disk.engine.connect() as connection:
        rows = connection.execute(select(journal_table).order_by(journal_table.c.id)).all()
    return [entry_of(row) for row in rows]
