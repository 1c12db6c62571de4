"""`skyfolio bench planner`: every case in a process of its own, then ratios, growth and targets."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from math import prod
from typing import Any, TypeAlias

import numpy as np

from skyfolio.api.lab.bench.cases import KINDS, SIZES
from skyfolio.api.lab.bench.measure import machine
from skyfolio.api.lab.bench.quality import targets as quality_targets
from skyfolio.planner.utilities import UTILITIES

Row: TypeAlias = dict[str, Any]
Size: TypeAlias = tuple[int, int, int]
Runner: TypeAlias = Callable[[str, Size, str], Row]
TIMEOUT_S, QUALITY_TIMEOUT_S = 150.0, 1800.0
YARDSTICK_SIZES = {("reference", "sum"): 1, ("reference", "per_user"): 1, ("ipopt", "sum"): 3, ("ipopt", "per_user"): 1}
"""On how many of the sizes, from the smallest, each yardstick can run at all in minutes."""
COLD_MS = {"3x9x20": 1.0, "10x100x50": 10.0, "20x300x100": 40.0, "50x1000x100": 250.0}
REPLAN_MS = {"3x9x20": 0.2, "10x100x50": 1.0, "20x300x100": 8.0, "50x1000x100": 30.0}


def planner_figures(*, quick: bool, run: Runner | None = None, sizes: Sequence[Size] = SIZES) -> Row:
    """Return all figures of the planner's benchmark; `quick` keeps to the two smaller sizes and few runs.

    run: measures one case (name, size, kind); default: alone in a process of its own.
    """
    run = run or (lambda case, size, kind: in_a_process(case, size, kind, quick=quick))
    rows = [
        _row(index, size, kind, quick, run)
        for index, size in enumerate(sizes[: 2 if quick else None])
        for kind in KINDS
    ]
    figures: Row = {"machine": machine(), "quick": quick, "rows": rows, "growth": {k: _growth(rows, k) for k in KINDS}}
    for case in ("ablation", "proof"):
        figures[case] = {kind: run(case, sizes[0], kind) for kind in KINDS}
    figures["quality"] = {
        "x".join(map(str, size)): {kind: run("quality", size, kind) for kind in UTILITIES}
        for size in sizes[1 : 2 if quick else None]
    }
    figures["targets"] = [*targets(figures), *quality_targets(figures)]
    return figures


def _row(index: int, size: Size, kind: str, quick: bool, run: Runner) -> Row:
    """Measure the product and the yardsticks at one size."""
    row: Row = {"size": "x".join(map(str, size)), "kind": kind, "ukn": prod(size), "fast": run("fast", size, kind)}
    for yardstick in ("reference", "ipopt"):
        within = 1 if quick else YARDSTICK_SIZES[yardstick, kind]
        why = "left out by --quick" if quick else "takes longer than this benchmark may"
        row[yardstick] = run(yardstick, size, kind) if index < within else {"skipped": why}
    return row | {"ratios": _ratios(row)}


def in_a_process(case: str, size: Size, kind: str, *, quick: bool) -> Row:
    """Return the figures of one case, or the reason why there are none."""
    name = "x".join(map(str, size))
    command = [sys.executable, "-m", "skyfolio.api.lab.bench.child", case, name, kind, *(["--quick"] if quick else [])]
    timeout_s = QUALITY_TIMEOUT_S if case == "quality" else TIMEOUT_S
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, capture_output=True, text=True, timeout=timeout_s, check=True, env={**os.environ, **one_thread}
        )
    except subprocess.TimeoutExpired:
        return {"skipped": f"not done after {timeout_s:.0f} s"}
    except subprocess.CalledProcessError as error:
        return {"skipped": (error.stderr.strip().splitlines() or ["failed"])[-1]}
    figures: Row = json.loads(done.stdout)
    return figures


def _ratios(row: Row) -> Row:
    """Return each yardstick's processor time over ours, and by how much our utility is above its."""
    ratios: Row = {}
    for yardstick in ("reference", "ipopt"):
        for what in ("plan", "replan"):
            theirs, ours = row[yardstick].get(what), row["fast"].get(what)
            if theirs and ours:
                ratios[f"{yardstick}_{what}_time"] = theirs["cpu_p50_ms"] / ours["cpu_p50_ms"]
                ratios[f"{yardstick}_{what}_utility"] = ours["utility_kbps"] / theirs["utility_kbps"] - 1
    return ratios


def _growth(rows: list[Row], kind: str) -> Row:
    """Return the exponent of time against U K N, by least squares over the sizes on logarithmic axes."""
    mine = [row for row in rows if row["kind"] == kind and "plan" in row["fast"]]
    if len(mine) < 2:
        return {}
    size = np.log([row["ukn"] for row in mine])
    return {
        f"{what}_exponent": float(np.polyfit(size, np.log([row["fast"][what]["cpu_p50_ms"] for row in mine]), 1)[0])
        for what in ("plan", "replan")
    }


def targets(figures: Row) -> list[Row]:
    """Return the targets beside the measurements; times as processor time, which on an idle core is the time."""
    rows: list[Row] = []
    for row in figures["rows"]:
        if "plan" not in row["fast"]:
            continue
        slack = 1.0 if row["kind"] == "sum" else 10.0
        name = f"{row['size']} {row['kind']}"
        for what, key, limits in (("cold plan", "plan", COLD_MS), ("replan", "replan", REPLAN_MS)):
            if row["size"] in limits:
                measured, limit = row["fast"][key]["cpu_p50_ms"], slack * limits[row["size"]]
                rows.append(_at_most(f"{name}: {what}, ms", measured, limit))
        if row["kind"] == "sum":
            rows += _against_yardsticks(name, row)
    for kind, growth in figures["growth"].items():
        if growth:
            rows.append(_at_most(f"{kind}: exponent of cold plan time", growth["plan_exponent"], 1.1))
    proven = figures["proof"]["sum"]
    if "root_gap_mean" in proven:
        rows.append(_at_most("sum: root gap at the letter's size", proven["root_gap_mean"], 0.25))
        rows.append(_at_most("sum: gap after branch and bound", proven["gap_mean"], 0.05))
    return rows


def _against_yardsticks(name: str, row: Row) -> list[Row]:
    rows, ratios = [], row["ratios"]
    if "reference_plan_time" in ratios:
        rows.append(_at_least(f"{name}: times faster than the reference path", ratios["reference_plan_time"], 1000.0))
        rows.append(_at_least(f"{name}: utility over the reference path's", ratios["reference_plan_utility"], 0.0))
    if "ipopt_plan_time" in ratios and row["size"] != "3x9x20":
        rows.append(_at_least(f"{name}: times faster than IPOPT", ratios["ipopt_plan_time"], 50.0))
        rows.append(_at_least(f"{name}: utility over IPOPT's", ratios["ipopt_plan_utility"], -0.001))
    if "plan_starts" in row["fast"]:
        starts = row["fast"]["plan_starts"]
        rows.append(_at_most(f"{name}: {starts['starts']} starts, ms", starts["cpu_p50_ms"], 30.0))
        if "best_of" in row["ipopt"]:
            best = row["ipopt"]["best_of"]
            over = starts["utility_kbps"] / best["utility_kbps"] - 1
            rows.append(_at_least(f"{name}: multi-start over the best of {best['starts']} IPOPT starts", over, -0.005))
    return rows


def _at_most(what: str, measured: float, limit: float) -> Row:
    return {"what": what, "measured": measured, "at_most": limit, "met": measured <= limit}


def _at_least(what: str, measured: float, limit: float) -> Row:
    return {"what": what, "measured": measured, "at_least": limit, "met": measured >= limit}
