"""How far one service goes: vehicles on its link, subscribers, events, plans, and what a flight stores."""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from dataclasses import dataclass, field
from typing import Any, Self

from sqlalchemy import func, select, text

from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.operation_views import ENDED, State
from skyfolio.api.lab.bench.bridge_sockets import load_row
from skyfolio.api.lab.bench.service import airborne, grid_scenario, rate_figures
from skyfolio.api.lab.bench.streams import Listening, process_figures, streams_figures
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import VirtualLoop
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.tables import events as event_table
from skyfolio.planner import Scenario

SLIP = {"uav_id": "uav-23", "slot": 11, "distance_m": 0.731, "late_s": 0.214, "operation_id": "op-0123456789ab"}
"""An event of the kind that there are most of."""
AT_A_TIME = 200
"""Events that are added before the loop has a turn."""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """vehicles: on one link, each for `load_s`; flying: UAVs that a whole service flies, watched for as long.

    subscribers: to one service, each as `listening` says. events: stored for the rate of the log; rate_for_s: how long
    plans are asked for; flown: UAVs of an operation in virtual time.
    """

    vehicles: tuple[int, ...] = (3, 10, 50, 100, 200)
    load_s: float = 10.0
    flying: tuple[int, ...] = (10, 50)
    subscribers: tuple[int, ...] = (100, 500, 1000)
    listening: Listening = field(default_factory=Listening)
    events: int = 20_000
    rate_for_s: float = 10.0
    flown: tuple[int, ...] = (3, 10)

    @classmethod
    def quick(cls) -> Self:
        """Return the least that shows every part."""
        few = Listening(vehicles=2, for_s=1.0, events=4)
        part = {"vehicles": (2, 3), "flying": (), "subscribers": (3,), "flown": (2,)}
        return cls(load_s=0.5, listening=few, events=50, rate_for_s=0.2, **part)


async def service_rows(sizes: Sizes, database_url: str | None = None) -> dict[str, Any]:
    """Measure one service. database_url: an empty database whose rate of events is measured beside SQLite's."""
    stored = [await _events_row("SQLite", None, sizes.events)]
    if database_url is not None:
        stored.append(await _events_row("PostgreSQL", database_url, sizes.events))
    return {
        "bridge": [await load_row(sizes.load_s, vehicles) for vehicles in sizes.vehicles],
        "flying": [await _flying_row(grid_scenario(uavs), sizes.load_s) for uavs in sizes.flying],
        "streams": [await streams_figures(sizes.listening, subscribers) for subscribers in sizes.subscribers],
        "events": stored,
        "plans": await rate_figures(sizes.rate_for_s),
        "flights": [await asyncio.to_thread(_flown, grid_scenario(uavs)) for uavs in sizes.flown],
        "load": os.getloadavg()[0],
    }


async def _flying_row(scenario: Scenario, seconds: float) -> dict[str, Any]:
    """Measure the process of a service that flies a plan with simulated vehicles of this process, in real time.

    Its solver is a process of its own, and is not counted.
    """
    async with airborne(scenario) as (client, _, _):
        before, began = await process_figures(client), time.perf_counter()
        await asyncio.sleep(seconds)
        after, took_s = await process_figures(client), time.perf_counter() - began
    share = (after["cpu_s"] - before["cpu_s"]) / took_s
    return {"vehicles": len(scenario.uavs), "share_of_one_core": share, "memory_mb": after["memory_mb"]}


async def _events_row(kind: str, url: str | None, count: int) -> dict[str, Any]:
    """Add events as fast as they are stored: how many a second, and bytes for each. Raises StoreError if any exist."""
    with tempfile.TemporaryDirectory() as folder:
        database = await Database.open(url or f"sqlite+aiosqlite:///{folder}/events.db")
        try:
            log = await EventLog.open(database)
            if log.last_id:
                raise StoreError("database_url: events are there already; give an empty database")
            before = await _bytes(database)
            began = time.perf_counter()
            for number in range(count):
                log.add("slip", **SLIP)
                if number % AT_A_TIME == 0:
                    await asyncio.sleep(0)
            await database.write(select(1))  # what was written before is stored when this is
            seconds = time.perf_counter() - began
            held = (await database.rows(select(func.count()).select_from(event_table)))[0][0]
            grown = await _bytes(database) - before
        finally:
            await database.close()
    return {
        "database": kind,
        "events": count,
        "stored": held,
        "per_s": count / seconds,
        "per_day": count / seconds * 86_400,
        "bytes_per_event": grown / count,
    }


async def _bytes(database: Database) -> int:
    """Return how much the database holds."""
    if database.is_postgresql:
        size = text("SELECT pg_total_relation_size('events')")
    else:
        size = text("SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()")
    return int((await database.rows(size))[0][0])


def _flown(scenario: Scenario) -> dict[str, Any]:
    """Fly a plan in virtual time: what the service stores of an operation in the air, whatever the machine does."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(_fly(scenario))


async def _fly(scenario: Scenario) -> dict[str, Any]:
    async with Ground(scenario, seed=1) as ground:
        service = await ground.start()
        await ground.register()
        record = await ground.ask(service.plans.submit(scenario, fresh("plan")))
        await ground.ask(service.plans.wait(record, 60.0))
        started = await ground.ask(service.operations.start(record.id, "auto", fresh("operation")))
        taken: tuple[float, int, int, int] | None = None
        while True:
            view = await ground.ask(service.operations.view(started.id))
            if view.state in ENDED:
                break
            if view.state == State.FLYING and taken is None:
                taken = _so_far(ground)
            last = _so_far(ground)
            await asyncio.sleep(0.5)
        if taken is None or view.state != State.COMPLETED:
            raise RuntimeError(f"the flight ended {view.state}: {view.error}")
        seconds, commits, events, size = (now - before for now, before in zip(last, taken, strict=True))
    uavs = len(scenario.uavs)
    return {
        "uavs": uavs,
        "seconds": seconds,
        "commits_per_s": commits / seconds,
        "events_per_uav_hour": events / uavs / seconds * 3600,
        "bytes_per_uav_hour": size / uavs / seconds * 3600,
    }


def _so_far(ground: Ground) -> tuple[float, int, int, int]:
    """Return the second, and the commits, events and bytes that are stored."""
    with ground.disk.engine.connect() as connection:
        pages = connection.execute(text("SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()"))
        return ground.now_s, ground.disk.commits, len(ground.stored_events()), int(pages.scalar_one())
