"""What is asked of the planner beside what was measured; times are processor time, on an idle core the time."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod

import numpy as np

from skyfolio.api.lab.bench.best_known import Table
from skyfolio.api.lab.bench.figures import Row, figures_of, measured
from skyfolio.api.lab.bench.instances import size_of
from skyfolio.api.lab.bench.shares import gap, mean, replan_shares, searched_s, share, standard_rows
from skyfolio.planner.utilities import UTILITIES

COLD_MS = {"3x9x20": 1.0, "10x100x50": 10.0, "20x300x100": 40.0, "50x1000x100": 250.0}
REPLAN_MS = {"3x9x20": 0.2, "10x100x50": 1.0, "20x300x100": 8.0, "50x1000x100": 30.0}
ASKED = {
    "10x100x50": {"share": 0.99, "sum_ms": 120.0, "other_ms": 500.0, "replan_ms": 30.0, "gap": 0.2, "proven": 0.08},
    "20x300x100": {
        "share": 0.985,
        "sum_ms": 400.0,
        "other_ms": 1500.0,
        "replan_ms": 100.0,
        "gap": 0.25,
        "proven": 0.12,
    },
    "50x1000x100": {"share": 0.98, "sum_ms": 1500.0, "other_ms": 6000.0, "replan_ms": 400.0, "gap": 0.3},
}
REPLAN_SHARE = 0.98


def of_quality(figures: Row, known: Table) -> list[Row]:
    """Return what is asked of plans of fleets, means over the standard layouts; what was not measured is None.

    Whether a share is enough is only judged where every best known value was searched for: some are just those of the
    plans that are measured here.
    """
    found = [row for size in ASKED for kind in UTILITIES for row in _of_plans(figures, size, kind, known)]
    for size, asked in ASKED.items():
        if "proven" in asked:
            gaps = [row["gap"] for row in (figures_of(figures, "bound", size, "sum") or {"instances": []})["instances"]]
            what = f"{size} sum: gap of `skyfolio bound` in a minute, layouts: {len(gaps)}"
            found.append(_at_most(what, mean(gaps), asked["proven"]))
    broken = [float(len(case["broken"])) for _, _, case in measured(figures, "checked")]
    return [*found, _at_most("random plans and replans that break a rule", mean(broken), 0.0)]


def _of_plans(figures: Row, size: str, kind: str, known: Table) -> Iterator[Row]:
    rows, asked, name = standard_rows(figures, size, kind), ASKED[size], f"{size} {kind}"
    shares = [share(row["name"], row["utility_kbps"], known) for row in rows]
    plan_ms = mean([row["plan"]["cpu_p50_ms"] for row in rows])
    replan_ms = mean([row["replan"]["call"]["cpu_p50_ms"] for row in rows])
    of_best = _at_least(f"{name}: share of best known", mean(shares), asked["share"])
    yield of_best if all(searched_s(row["name"], known) for row in rows) else {**of_best, "met": None}
    yield _at_most(f"{name}: `plan()`, ms", plan_ms, asked["sum_ms" if kind == "sum" else "other_ms"])
    yield _at_most(f"{name}: `replan()` after a loss, ms", replan_ms, asked["replan_ms"])
    yield _at_least(f"{name}: replan, share of more searching", mean(replan_shares(rows)), REPLAN_SHARE)
    if kind == "sum":
        yield _at_most(f"{name}: gap with the plan", mean([gap(row) for row in rows]), asked["gap"])


def of_times(figures: Row) -> list[Row]:
    """Return what is asked of one climb from hovering, beside other solvers from the same start."""
    rows: list[Row] = []
    for size, kind, ours in measured(figures, "fast"):
        slack = 1.0 if kind == "sum" else 10.0
        for what, key, limits in (("cold plan", "plan", COLD_MS), ("replan", "replan", REPLAN_MS)):
            if size in limits:
                rows.append(_at_most(f"{size} {kind}: {what}, ms", ours[key]["cpu_p50_ms"], slack * limits[size]))
        if kind == "sum":
            rows += _against_yardsticks(figures, size, ours)
    rows += _of_extensions(figures)
    for kind, growth in growths(figures):
        rows.append(_at_most(f"{kind}: exponent of cold plan time", growth["plan"], 1.1))
    for _, kind, proven in measured(figures, "proof"):
        if kind == "sum":
            rows.append(_at_most("sum: root gap at the letter's size", proven["root_gap_mean"], 0.25))
            rows.append(_at_most("sum: gap after branch and bound", proven["gap_mean"], 0.05))
    return rows


def _of_extensions(figures: Row) -> Iterator[Row]:
    for size, kind, of_users in measured(figures, "users"):
        for row in of_users["rows"]:
            yield _at_most(f"{size} {kind}: `plan()` of {row['what']}, times the plain one", row["ratio"], 2.0)
    for size, kind, ground in measured(figures, "terrain"):
        for name, what in (("terrain", "over hills"), ("altitudes", "with altitudes chosen over hills")):
            ratio = ground[name]["plan_call"]["ratio"]
            yield _at_most(f"{size} {kind}: `plan()` {what}, times the level one", ratio, 2.0)


def _against_yardsticks(figures: Row, size: str, ours: Row) -> Iterator[Row]:
    name, against = f"{size} sum", ratios(figures, size, "sum")
    if "reference plan time" in against:
        yield _at_least(f"{name}: times faster than the reference path", against["reference plan time"], 1000.0)
        yield _at_least(f"{name}: utility over the reference path's", against["reference plan utility"], 0.0)
    if "ipopt plan time" in against and size != "3x9x20":
        yield _at_least(f"{name}: times faster than IPOPT", against["ipopt plan time"], 50.0)
        yield _at_least(f"{name}: utility over IPOPT's", against["ipopt plan utility"], -0.001)
    if "plan_starts" in ours:
        starts = ours["plan_starts"]
        yield _at_most(f"{name}: {starts['starts']} starts, ms", starts["cpu_p50_ms"], 30.0)
        best = (figures_of(figures, "ipopt", size, "sum") or {}).get("best_of")
        if best:
            over = starts["utility_kbps"] / best["utility_kbps"] - 1
            yield _at_least(f"{name}: multi-start over the best of {best['starts']} IPOPT starts", over, -0.005)


def ratios(figures: Row, size: str, kind: str) -> dict[str, float]:
    """Return each yardstick's processor time over ours, and by how much our utility is above its."""
    found: dict[str, float] = {}
    ours = figures_of(figures, "fast", size, kind) or {}
    for yardstick in ("reference", "ipopt"):
        theirs = figures_of(figures, yardstick, size, kind) or {}
        for what in ("plan", "replan"):
            if what in theirs and what in ours:
                found[f"{yardstick} {what} time"] = theirs[what]["cpu_p50_ms"] / ours[what]["cpu_p50_ms"]
                found[f"{yardstick} {what} utility"] = ours[what]["utility_kbps"] / theirs[what]["utility_kbps"] - 1
    return found


def growths(figures: Row) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield by utility the exponents of time against U K N, by least squares over the sizes on logarithmic axes."""
    cases = list(measured(figures, "fast"))
    for kind in dict.fromkeys(kind for _, kind, _ in cases):
        mine = [(prod(size_of(size)), case) for size, of, case in cases if of == kind]
        if len(mine) > 1:
            cells = np.log([one for one, _ in mine])
            spent = {what: np.log([case[what]["cpu_p50_ms"] for _, case in mine]) for what in ("plan", "replan")}
            yield kind, {what: float(np.polyfit(cells, times, 1)[0]) for what, times in spent.items()}


def _at_most(what: str, found: float, limit: float) -> Row:
    return _judged(what, found, "at_most", limit, met=found <= limit)


def _at_least(what: str, found: float, limit: float) -> Row:
    return _judged(what, found, "at_least", limit, met=found >= limit)


def _judged(what: str, found: float, asked: str, limit: float, *, met: bool) -> Row:
    """Return one target; what was not measured (not a number) is neither met nor missed."""
    if np.isnan(found):
        return {"what": what, "measured": None, asked: limit, "met": None}
    return {"what": what, "measured": found, asked: limit, "met": met}
