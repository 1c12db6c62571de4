"""`skyfolio bench scale`: how far one machine and one service go, and what many areas need.

Sweeps on 1 to 4 workers and what limits them (`scale_sweep.py`), sweeps whose workers are killed and that are stopped
(`scale_faults.py`), one service (`scale_service.py`), and the calculation for many areas (`many_areas.py`). Every
figure says how busy the machine was with other things.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any

from skyfolio.api.common import kernels
from skyfolio.api.lab.bench.many_areas import Assumed, demand_of, measured_of
from skyfolio.api.lab.bench.measure import machine, peak_mb
from skyfolio.api.lab.bench.scale_faults import killed_row, stop_row
from skyfolio.api.lab.bench.scale_limits import with_limits
from skyfolio.api.lab.bench.scale_service import Sizes, service_rows
from skyfolio.api.lab.bench.scale_sweep import Size, alone_row, copied, engine_rows, on_cores, pool_row, swept_row
from skyfolio.planner import assess, plan, replan
from skyfolio.planner.layouts import laid_out

STRONG = (Size(1, 1), Size(1, 2), Size(2, 1), Size(2, 2), Size(2, 3), Size(2, 4))
WEAK = (Size(1, 1), Size(2, 2))
AREA = (50, 200, 20)
"""UAVs, users and slots of one area in the calculation for many."""


@dataclass(frozen=True, kw_only=True)
class Extent:
    """How much is measured.

    cases: of the sweep; kill_every_s, kills: of workers; stops: how often a sweep is stopped; pools: sizes of plain
    pools of processes; area: UAVs, users, slots of one area; rounds: batches without work, for what a batch costs.
    """

    cases: int = 160
    strong: tuple[Size, ...] = STRONG
    weak: tuple[Size, ...] = WEAK
    kill_every_s: float = 30.0
    kills: int = 4
    stops: int = 3
    area: tuple[int, int, int] = AREA
    rounds: int = 400
    service: Sizes = field(default_factory=Sizes)
    pools: tuple[Size, ...] = (Size(1, 1), Size(2, 2))


QUICK = Extent(
    cases=8,
    strong=(Size(1, 1),),
    weak=(Size(1, 1),),
    pools=(Size(1, 1),),
    kill_every_s=0.2,
    kills=1,
    stops=1,
    area=(4, 12, 8),
    rounds=20,
    service=Sizes.quick(),
)
"""Every part once, on the smallest sizes: figures of this are worth nothing, but it takes seconds."""


def scale_figures(
    extent: Extent, database_url: str | None = None, note: Callable[[str], None] = lambda _part: None
) -> dict[str, Any]:
    """Return all figures, as plain JSON data. database_url: an empty PostgreSQL database to measure, too.

    note: called with the name of each part as it begins.
    """
    begun = machine()
    kernels.load_all()
    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "sweep": lambda: _sweep(extent),
        "killed": lambda: asyncio.run(killed_row(extent.kill_every_s, extent.kills)),
        "stopped": lambda: stop_row(extent.stops),
        "robustness": _robustness,
        "area": lambda: _area(extent.area),
        "service": lambda: asyncio.run(service_rows(extent.service, database_url)),
    }
    figures: dict[str, Any] = {"machine": begun, "extent": asdict(extent)}
    for name, measure in parts.items():
        note(name)
        figures[name] = measure()
    figures["load_after"] = os.getloadavg()[0]
    assumed = Assumed()
    demand = demand_of(measured_of(figures), assumed)
    return {**figures, "many": {"assumed": asdict(assumed), "needed": asdict(demand)}}


def _sweep(extent: Extent) -> dict[str, Any]:
    """Measure sweeps of the same cases, and of cases in proportion to the workers, beside what they could reach."""
    cores = len(os.sched_getaffinity(0))
    swept = cache(swept_row)  # one worker's sweep of all cases is the first of both tables
    strong = [swept(extent.cases, size) for size in extent.strong if size.cores <= cores]
    weak = [swept(extent.cases * size.workers, size) for size in extent.weak if size.cores <= cores]
    return {
        "cases": extent.cases,
        "alone": alone_row(extent.cases),
        "pool": [pool_row(extent.cases, size) for size in extent.pools if size.cores <= cores],
        "strong": with_limits(strong),
        "weak": [{**row, "efficiency": weak[0]["seconds"] / row["seconds"]} for row in weak],
        "engine": engine_rows(extent.rounds),
        "memory": [copied(size.workers) for size in extent.pools if size.cores <= cores],
    }


def _robustness() -> dict[str, Any]:
    """Time a default assessment of the letter's scenario: 200 draws, six losses."""
    made = plan(laid_out("uniform", 3, 9, 20, seed=1))
    began = time.perf_counter()
    found = assess(made)
    return {"seconds": time.perf_counter() - began, "draws": found.draws, "losses": len(found.losses)}


def _area(size: tuple[int, int, int]) -> dict[str, Any]:
    """Plan one area of a large operation on one core, and replan it after a loss half-way; in processor seconds."""
    uavs, users, slots = size
    scenario = laid_out("uniform", uavs, users, slots, seed=1)
    with on_cores(1):
        began, cpu = time.perf_counter(), time.process_time()
        made = plan(scenario)
        seconds, plan_cpu_s = time.perf_counter() - began, time.process_time() - cpu
        cpu = time.process_time()
        replan(made, failed=[scenario.uav_ids[-1]], at_slot=slots // 2)
        replan_cpu_s = time.process_time() - cpu
    figures = {"seconds": seconds, "plan_cpu_s": plan_cpu_s, "replan_cpu_s": replan_cpu_s, "peak_mb": peak_mb()}
    slot_s = scenario.slot_duration_s
    return {"uavs": uavs, "users": users, "slots": slots, "slot_s": slot_s, "gap": made.summary.gap, **figures}
