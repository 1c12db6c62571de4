"""How plans by areas grow with the fleet, and how near they come to planning at once."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from rich.table import Table

from skyfolio.api.common import kernels
from skyfolio.api.lab.bench.measure import machine, peak_mb
from skyfolio.api.lab.bench.tables import grid, on_terminal
from skyfolio.api.plans.area_threads import AreaThreads, cores
from skyfolio.planner import Plan, Scenario, Utility, plan, replan
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.methods import AREAS, DEFAULT_METHOD

SIZES = (100, 200, 500)
"""UAVs; each has so many users and all have so many slots:"""
USERS_A_UAV, SLOTS = 40, 100
COMPARED = ((20, 300, SLOTS), (50, 1000, SLOTS))
"""UAVs, users and slots that are also planned at once."""
LAYOUTS = (("clustered", 1), ("uniform", 2))
UTILITIES = (("sum", 0.0), ("sum", -0.01), ("per_user", -0.1), ("pooled", -0.1))
"""Kind and mu, 1/(kbit/s)."""


def areas_figures(
    sizes: Sequence[int] = SIZES,
    compared: Sequence[tuple[int, int, int]] = COMPARED,
    told: Callable[[dict[str, Any]], None] = lambda _: None,
) -> dict[str, Any]:
    """Return all figures, as plain JSON data, each plan made in a process of its own; some minutes.

    told: called with each row when it is there.
    """

    def alone(call: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
        row = _alone(call, *arguments)
        told(row)
        return row

    begun = machine()
    kernels.load_all()
    grown = [alone(_grown, n, *UTILITIES[0]) for n in sizes]
    grown += [alone(_grown, sizes[0], *utility) for utility in UTILITIES[1:]]
    beside = [alone(_beside, size, *one, *utility) for size in compared for utility in UTILITIES for one in LAYOUTS]
    return {
        "machine": begun,
        "cores": cores(),
        "grown": grown,
        "compared": beside,
        "load_after": os.getloadavg()[0],
    }


def _alone(call: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """Call in a new process, whose peak of memory is that of this call."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(call, *arguments).result()


def _grown(n_uavs: int, kind: str, mu: float) -> dict[str, Any]:
    """Plan a large fleet, and plan it anew after a loss."""
    kernels.load_all()
    scenario = _scenario((n_uavs, USERS_A_UAV * n_uavs, SLOTS), *LAYOUTS[0], kind, mu)
    with AreaThreads() as run_areas:
        row, made = _timed(lambda: plan(scenario, method=AREAS, run_areas=run_areas))
        lost = scenario.uav_ids[n_uavs // 2]
        again, _ = _timed(lambda: replan(made, failed=[lost], at_slot=SLOTS // 4, method=AREAS, run_areas=run_areas))
    return {
        "uavs": n_uavs,
        "users": len(scenario.users),
        "slots": SLOTS,
        "kind": kind,
        "mu_per_kbps": mu,
        **row,
        "replan": again,
        "peak_mb": peak_mb(),
    }


def _beside(size: tuple[int, int, int], layout: str, seed: int, kind: str, mu: float) -> dict[str, Any]:
    """Plan a fleet by areas and at once."""
    kernels.load_all()
    scenario = _scenario(size, layout, seed, kind, mu)
    with AreaThreads() as run_areas:
        by_areas, _ = _timed(lambda: plan(scenario, method=AREAS, run_areas=run_areas))
    at_once, _ = _timed(lambda: plan(scenario, method=DEFAULT_METHOD))
    return {
        "size": "x".join(map(str, size)),
        "layout": layout,
        "kind": kind,
        "mu_per_kbps": mu,
        "areas": by_areas,
        "at_once": at_once,
        "ratio": by_areas["utility_bps"] / at_once["utility_bps"],
    }


def _scenario(size: tuple[int, int, int], layout: str, seed: int, kind: str, mu: float) -> Scenario:
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    return laid_out(layout, *size, seed=seed, utility=utility)


def _timed(make: Callable[[], Plan]) -> tuple[dict[str, Any], Plan]:
    began, cpu_s = time.perf_counter(), time.process_time()
    made = make()
    figures = {
        "seconds": time.perf_counter() - began,
        "cpu_s": time.process_time() - cpu_s,
        "utility_bps": made.summary.utility_bps,
        "gap": made.summary.gap,
    }
    return figures, made


def tables(figures: dict[str, Any]) -> list[Table]:
    """Return the figures as tables for a terminal."""
    return [on_terminal(title, [columns, *rows]) for title, columns, rows in _rows(figures)]


def markdown(figures: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    of = figures["machine"]
    where = f"{of['cpu']}, {figures['cores']} cores, Python {of['python']}"
    loads = f"load of the last minute {of['load']:.1f} before and {figures['load_after']:.1f} after"
    lines = [
        "# Large fleets, by areas",
        "",
        "Written by `skyfolio bench areas`; [planner.md](../planner.md#large-fleets-by-areas) says how it works.",
        f"{where}; {loads}. CPU seconds are those of all threads, and what other programs do hardly changes them.",
        "A plan's time includes its certificate and the check of all constraints.",
    ]
    for title, columns, rows in _rows(figures):
        lines += ["", f"## {title}", "", grid([columns, *rows])]
    return "\n".join(lines) + "\n"


def _rows(figures: dict[str, Any]) -> list[tuple[str, list[str], list[list[str]]]]:
    grown = [
        [
            f"{row['uavs']}x{row['users']}x{row['slots']}",
            _utility(row),
            f"{row['seconds']:.1f}",
            f"{row['cpu_s']:.1f}",
            f"{row['cpu_s'] / row['uavs'] * 1e3:.0f}",
            f"{row['peak_mb'] / 1e3:.2f}",
            f"{row['utility_bps'] / 1e3:.1f}",
            f"{row['gap']:.1%}",
            f"{row['replan']['seconds']:.1f}",
            f"{row['replan']['cpu_s']:.1f}",
        ]
        for row in figures["grown"]
    ]
    beside = [
        [
            row["size"],
            row["layout"],
            _utility(row),
            f"{row['at_once']['utility_bps'] / 1e3:.2f}",
            f"{row['areas']['utility_bps'] / 1e3:.2f}",
            f"{row['ratio'] - 1.0:+.2%}",
            f"{row['at_once']['cpu_s']:.1f}",
            f"{row['areas']['cpu_s']:.1f}",
        ]
        for row in figures["compared"]
    ]
    size = ["UAVs x users x slots", "utility (mu)"]
    costs = ["seconds", "CPU s", "CPU ms a UAV", "peak GB", "kbit/s", "gap", "replan, s", "replan, CPU s"]
    values = ["at once, kbit/s", "by areas, kbit/s", "difference", "at once, CPU s", "by areas, CPU s"]
    found = [
        ("Plans, and replans after one loss", [*size, *costs], grown),
        ("Beside plans of the whole fleet at once", [size[0], "layout", size[1], *values], beside),
    ]
    return [table for table in found if table[2]]


def _utility(row: dict[str, Any]) -> str:
    return f"`{row['kind']}` ({row['mu_per_kbps']:g})"
