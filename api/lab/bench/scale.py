"""How sweeps scale with workers and cores, what a cluster costs, and how fast a sweep stops."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.table import Table

from skyfolio.api.common import kernels
from skyfolio.api.common.dask_cluster import own_cluster
from skyfolio.api.lab.bench.measure import machine, peak_mb
from skyfolio.api.lab.sweep.case import row_of
from skyfolio.api.lab.sweep.farm import farmed
from skyfolio.api.lab.sweep.parts import Batch, batches_of, compute
from skyfolio.api.lab.sweep.spec import Spec, spec_of
from skyfolio.planner import assess, plan
from skyfolio.planner.layouts import laid_out

PURPOSE = "bench scale"
STRONG = ((1, 1), (1, 2), (2, 1), (2, 2), (2, 3), (2, 4))
"""(cores, workers) of the same cases."""
WEAK = ((1, 1), (2, 2))
"""(cores, workers) of cases in proportion to the workers."""
AREA = (50, 200, 20)
"""UAVs, users and slots of one area in the calculation for many."""
MANY = 100
"""Areas in that calculation."""


def scale_figures(cases: int) -> dict[str, Any]:
    """Return all figures, as plain JSON data. cases: how many one worker computes; takes some minutes."""
    begun = machine()
    kernels.load_all()
    alone = _alone(cases)
    cores = os.cpu_count() or 1
    strong = [_swept(cases, *size) for size in STRONG if size[0] <= cores]
    weak = [_swept(cases * workers, cores_, workers) for cores_, workers in WEAK if cores_ <= cores]
    return {
        "machine": begun,
        "cases": cases,
        "alone": alone,
        "strong": [{**row, "speedup": row["cases_per_s"] / strong[0]["cases_per_s"]} for row in strong],
        "weak": [{**row, "efficiency": weak[0]["seconds"] / row["seconds"]} for row in weak],
        "stop_s": asyncio.run(_stopped()),
        "robustness": _robustness(),
        "area": _area(),
        "load_after": os.getloadavg()[0],
    }


def study(cases: int) -> Spec:
    """Return the sweep that is measured: the letter's layouts at random, each planned and replanned after a loss."""
    vary = {"layout.seed": {"range": [0, cases - 1]}}
    fixed = {"failed": ["uav-1"], "utility.mu_per_kbps": -0.1}
    return spec_of({"batch": 8, "base": {"layout": {"kind": "letter"}}, "set": fixed, "vary": vary})


def _alone(cases: int) -> dict[str, Any]:
    """Compute the cases in this process, without a cluster."""
    spec = study(cases)
    began, cpu_s = time.perf_counter(), time.process_time()
    with _on_cores(1):
        for varied in spec.cases():
            row_of(spec.base, {**spec.fixed, **varied})
    seconds = time.perf_counter() - began
    cpu_ms = (time.process_time() - cpu_s) / cases * 1e3
    return {"seconds": seconds, "cases_per_s": cases / seconds, "cpu_ms_per_case": cpu_ms}


def _swept(cases: int, cores: int, workers: int) -> dict[str, Any]:
    with _on_cores(cores):
        seconds, cpu_s = asyncio.run(_computed(batches_of(study(cases)), workers))
    load = os.getloadavg()[0]
    return {
        "cores": cores,
        "workers": workers,
        "cases": cases,
        "seconds": seconds,
        "cases_per_s": cases / seconds,
        "cpu_ms_per_case": cpu_s / cases * 1e3,
        "load": load,
    }


async def _computed(batches: Sequence[Batch], workers: int) -> tuple[float, float]:
    """Return the seconds from the first batch to the last result, and the processor seconds of all workers.

    Workers have loaded their kernels before.
    """
    async with own_cluster(workers, PURPOSE) as client:
        await client.run(kernels.load_all)
        spent = sum((await client.run(time.process_time)).values())
        began = time.perf_counter()
        async for done in farmed(client, compute, batches, asyncio.Event()):
            assert done.error is None, done.error  # noqa: S101 - a figure of broken batches would be none
        seconds = time.perf_counter() - began
        return seconds, sum((await client.run(time.process_time)).values()) - spent


async def _stopped() -> float:
    """Return the seconds from Ctrl-C until all workers have ended, while each computes something that takes minutes."""
    long = {"base": {"layout": {"kind": "uniform", "uavs": 8, "users": 60, "slots": 400}}, "set": {"starts": 64}}
    stop = asyncio.Event()
    async with own_cluster(2, PURPOSE) as client:
        asyncio.get_running_loop().call_later(8.0, stop.set)
        async for _ in farmed(client, compute, batches_of(spec_of({**long, "vary": {"seed": [1, 2, 3]}})), stop):
            pass
        began = time.perf_counter()
    return time.perf_counter() - began


def _robustness() -> dict[str, Any]:
    """Time a default assessment of the letter's scenario: 200 draws, six losses."""
    made = plan(laid_out("uniform", 3, 9, 20, seed=1))
    began = time.perf_counter()
    found = assess(made)
    return {"seconds": time.perf_counter() - began, "draws": found.draws, "losses": len(found.losses)}


def _area() -> dict[str, Any]:
    """Plan one area of a large operation on one core."""
    uavs, users, slots = AREA
    scenario = laid_out("uniform", uavs, users, slots, seed=1)
    with _on_cores(1):
        began = time.perf_counter()
        made = plan(scenario)
        seconds = time.perf_counter() - began
    size = {"uavs": uavs, "users": users, "slots": slots}
    return {**size, "seconds": seconds, "gap": made.summary.gap, "peak_mb": peak_mb()}


@contextmanager
def _on_cores(count: int) -> Iterator[None]:
    """Run this process, and those that it starts meanwhile, on so many cores."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(before)[-count:]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def tables(figures: dict[str, Any]) -> list[Table]:
    """Return the figures as tables for a terminal."""
    found = []
    for title, columns, rows in _rows(figures):
        table = Table(*columns, title=title)
        for row in rows:
            table.add_row(*row)
        found.append(table)
    return found


def markdown(figures: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    machine_ = figures["machine"]
    where = f"{machine_['cpu']}, {machine_['cores']} cores, Python {machine_['python']}"
    loads = f"load of the last minute {machine_['load']:.1f} before and {figures['load_after']:.1f} after"
    lines = [
        "# How sweeps scale",
        "",
        "Written by `skyfolio bench scale`; [scaling.md](../scaling.md) says what follows from it.",
        f"{where}; {loads}.",
    ]
    for title, columns, rows in _rows(figures):
        lines += ["", f"## {title}", "", f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
        lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def _rows(figures: dict[str, Any]) -> list[tuple[str, list[str], list[list[str]]]]:
    alone, area = figures["alone"], figures["area"]
    in_process = [f"{alone['seconds']:.1f}", f"{alone['cases_per_s']:.1f}", f"{alone['cpu_ms_per_case']:.0f}", "-", "-"]
    strong = [["1", "none, in process", *in_process]]
    for row in figures["strong"]:
        sizes, cpu_ms = [str(row["cores"]), str(row["workers"])], f"{row['cpu_ms_per_case']:.0f}"
        paces = [f"{row['seconds']:.1f}", f"{row['cases_per_s']:.1f}", cpu_ms]
        strong.append([*sizes, *paces, f"{row['speedup']:.2f}", f"{row['load']:.1f}"])
    weak = []
    for row in figures["weak"]:
        sizes = [str(row[name]) for name in ("cores", "workers", "cases")]
        weak.append([*sizes, f"{row['seconds']:.1f}", f"{row['efficiency']:.0%}", f"{row['load']:.1f}"])
    robust = figures["robustness"]
    others = [
        ["from Ctrl-C in mid-solve until all workers have ended, s", f"{figures['stop_s']:.2f}"],
        [f"robustness: {robust['draws']} draws and {robust['losses']} losses of 3x9x20, s", f"{robust['seconds']:.2f}"],
        [f"plan of one area, {area['uavs']}x{area['users']}x{area['slots']}, one core, s", f"{area['seconds']:.2f}"],
        [
            f"{MANY} such areas, {MANY * area['uavs']:,} UAVs, planned once, core seconds",
            f"{MANY * area['seconds']:.0f}",
        ],
        ["peak memory of this process, MB", f"{area['peak_mb']:.0f}"],
    ]
    same = f"Strong scaling: the same {figures['cases']} cases"
    return [
        (same, ["cores", "workers", "seconds", "cases a second", "CPU ms a case", "speed-up", "load"], strong),
        ("Weak scaling", ["cores", "workers", "cases", "seconds", "efficiency", "load"], weak),
        ("Others", ["what", "figure"], others),
    ]
