"""Flies one drill, and returns what was broken."""

from __future__ import annotations

import asyncio
import gc
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import select

from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.journal import entry_of
from skyfolio.api.flights.operation_views import ENDED, OperationView, State
from skyfolio.api.lab.torture.blows import Arena
from skyfolio.api.lab.torture.drill import Drill
from skyfolio.api.lab.torture.invariants import AFTERWARDS, AT_END, MEANWHILE, look
from skyfolio.api.lab.torture.stations import serve
from skyfolio.api.lab.torture.triggers import Triggers
from skyfolio.api.lab.torture.watch import Seen, files_open_now
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import run
from skyfolio.api.service import Service
from skyfolio.api.store.event_log import Event
from skyfolio.api.store.tables import journal as journal_table
from skyfolio.api.store.tables import operations as operations_table
from skyfolio.planner import Scenario

LOOK_S = 0.5
AFTERMATH_S = 2.0
STUCK_S = 60.0
"""An operation that waits for its operator so long is aborted by them: paused, or interrupted by a restart."""
WAITS = frozenset({State.PAUSED, State.INTERRUPTED})
LIMIT_S = 700.0
"""Fleet seconds beside the plan's in which an operation must have ended."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a drill.

    broken: detail by invariant. coverage: (state, blow) of every blow that struck; moments: (moment, blow).
    """

    drill: Drill
    broken: dict[str, str]
    state: str
    coverage: Counter[tuple[str, str]]
    virtual_s: float
    wall_s: float
    moments: Counter[tuple[str, str]] = field(default_factory=Counter)
    events: list[Event] = field(default_factory=list)
    blows: list[str] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    """What happened, in order, a line each."""


def fly(drill: Drill, *, recording: Path | None = None) -> Outcome:
    """Fly a drill from the first start of the service to its end.

    recording: an SQLite file, written for a service that shows the flight in its dashboard.
    """
    began_s = time.perf_counter()
    seen, virtual_s = run(_fly(drill, recording))
    return Outcome(
        drill=drill,
        broken=dict(sorted(seen.broken.items())),
        state="none" if seen.end is None else seen.end.state.value,
        coverage=seen.coverage,
        moments=seen.moments,
        virtual_s=virtual_s,
        wall_s=time.perf_counter() - began_s,
        events=seen.events,
        blows=[f"{one.at_s:.2f} s, {one.state}: {one.blow}" for one in seen.struck],
        steps=seen.told,
    )


async def _fly(drill: Drill, recording: Path | None) -> Seen:
    files_open = files_open_now()
    async with drill.ground() as ground:
        scenario, other = drill.flown()
        seen = Seen(drill, ground, uavs=scenario.uav_ids, files_open=[files_open])
        arena = Arena(seen)
        triggers = Triggers(arena, drill.blows)
        ground.on_event, ground.after_step = triggers.note, triggers.look
        ground.fleet.truth.on_received = lambda at_s, system_id, message: seen.received.append(
            (at_s, system_id, message)
        )
        triggers.follow(await ground.start())
        await ground.register()
        plan_ids = [await _planned(ground, one) for one in (scenario, other) if one is not None]
        await _start(seen, plan_ids[0])
        if other is not None:
            await _start_beside(seen, other, plan_ids[1])
        triggers.begin()
        if drill.stations:
            for one in seen.each:
                arena.beside(serve(one))
        await _until_ended(seen, arena)
        await asyncio.sleep(AFTERMATH_S)
        while arena.tasks:
            await asyncio.wait(list(arena.tasks))
        gc.collect()
        for one in seen.each:
            one.follow_truth()
            one.look_into_memory()
        await ground.stop()
        _read_disk(seen)
        look(seen, AT_END)
        if recording is not None:
            ground.disk.save(recording)
    seen.files_open.append(files_open_now())
    look(seen, AFTERWARDS)
    return seen


async def _planned(ground: Ground, scenario: Scenario) -> str:
    service = ground.service
    assert service is not None  # noqa: S101 - it was just started
    record = await ground.ask(service.plans.submit(scenario, fresh("plan")))
    await ground.ask(service.plans.wait(record, 60.0))
    return record.id


async def _start(seen: Seen, plan_id: str) -> None:
    """Start the operation that is seen."""
    ground, service = seen.ground, seen.ground.service
    assert service is not None  # noqa: S101 - nothing has struck yet
    creation = fresh("operation")
    seen.operation_id = creation.id
    drill = seen.drill
    await ground.ask(service.operations.start(plan_id, drill.policy, creation, options=drill.options()))


async def _start_beside(seen: Seen, scenario: Scenario, plan_id: str) -> None:
    """Start an operation beside the first one, unless the service refuses that, or is killed before it is stored."""
    ground, service = seen.ground, seen.ground.service
    beside = seen.beside_it(scenario.uav_ids)
    if service is not None:
        try:
            await _start(beside, plan_id)
        except ServiceError as error:
            seen.tell(f"refused {error}")
        except asyncio.CancelledError:
            if ground.service is service:
                raise
            seen.tell("killed while the second operation was started")
    with ground.disk.engine.connect() as connection:
        stored = connection.execute(select(operations_table.c.id).where(operations_table.c.id == beside.operation_id))
        if stored.first() is None:
            seen.beside = None


async def _until_ended(seen: Seen, arena: Arena) -> None:
    """Look again and again until all operations have ended; see to one that waits for its operator."""
    ground, scenario = seen.ground, seen.ground.scenario
    limit_s = ground.now_s + scenario.slots * scenario.slot_duration_s + LIMIT_S
    waits_since_s: float | None = None
    while ground.now_s < limit_s:
        await asyncio.sleep(LOOK_S)
        for one in seen.each:
            one.follow_truth()
            one.excuse(LOOK_S, down=arena.down)
            one.follow_operation()
        look(seen, MEANWHILE)
        seen.received.clear()
        for one in seen.each:
            one.news.clear()
        states = [await _state(one, arena) for one in seen.each]
        if all(one.end is not None for one in seen.each):
            return
        waits = any(state in WAITS for state in states)
        waits_since_s = (waits_since_s or ground.now_s) if waits else None
        if waits_since_s is not None and ground.now_s - waits_since_s >= STUCK_S:
            waits_since_s = None
            arena.note_orders()
            arena.command_each(lambda service, of: service.operations.abort(of, "land"))
    for one in seen.each:
        one.end = one.end or await _view(one, arena)


async def _state(seen: Seen, arena: Arena) -> State | None:
    """Return the state of an operation, and keep its view once it has ended; None while its service does not answer."""
    if seen.end is not None:
        return seen.end.state
    operation = None if arena.down else seen.operation()
    if operation is not None:
        return operation.state
    view = await _view(seen, arena)
    if view is not None and view.state in ENDED:
        seen.end = view
    return None if view is None else view.state


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


def _read_disk(seen: Seen) -> None:
    """Take in what is stored of each operation."""
    events, held_lines = seen.ground.stored_events(), seen.ground.disk.held_lines()
    for one in seen.each:
        query = select(journal_table).where(journal_table.c.operation_id == one.operation_id)
        with one.ground.disk.engine.connect() as connection:
            rows = connection.execute(query.order_by(journal_table.c.id)).all()
        one.events, one.journal, one.held_lines = events, [entry_of(row) for row in rows], held_lines
        one.note_reports(one.end.recoveries if one.end is not None else ())
