"""Shares of the best known values: what was measured beside the best that was ever found, as far as known by now."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from skyfolio.api.lab.bench.best_known import Table
from skyfolio.api.lab.bench.figures import Row, figures_of
from skyfolio.api.lab.bench.instances import NOISE_DBM, UTILITIES


class Value(NamedTuple):
    """What somebody found for an instance, kbit/s, and in how much processor time."""

    name: str
    utility_kbps: float
    found_by: str
    seconds: float


def values_of(section: str, figures: Row) -> Iterator[Value]:
    """Yield the values of whole plans in the figures of a part."""
    if section == "peers" and figures:
        for peer, found in figures["peers"].items():
            yield Value(figures["name"], found["utility_kbps"], f"peer {peer}", found["cpu_s"])
    elif section in {"quality", "budgets"}:
        for row in figures.get("instances", ()):
            by = f"planner, {row.get('times', 1)}x the default budget"
            yield Value(row["name"], row["utility_kbps"], by, row["plan"]["cpu_p50_ms"] / 1e3)


def share(name: str, utility_kbps: float, known: Table) -> float:
    """Return the share of the best known value; a value that is better than what is known has all of it."""
    best = known.get(name, {}).get("utility_kbps", utility_kbps)
    return float(utility_kbps / max(best, utility_kbps))


def searched_s(name: str, known: Table) -> float:
    """Return the longest search behind a best known value, seconds of processor time; 0 for none."""
    return float(max(known.get(name, {}).get("searched", {}).values(), default=0.0))


def standard_rows(figures: Row, size: str, kind: str) -> list[Row]:
    """Return the measured instances of a size and utility over whose layouts means are taken."""
    rows = (figures_of(figures, "quality", size, kind) or {"instances": []})["instances"]
    return [row for row in rows if (kind, row["mu_per_kbps"]) in UTILITIES and row["noise_dbm"] == NOISE_DBM]


def mean(values: list[float]) -> float:
    """Return the mean; of nothing, nothing is known."""
    return float(np.mean(values)) if values else float("nan")


def replan_shares(rows: list[Row]) -> list[float]:
    """Return the shares that replans reach of the best of more searching, of those that were compared."""
    compared = [row["replan"] for row in rows if "best_of_more_kbps" in row["replan"]]
    return [one["utility_kbps"] / one["best_of_more_kbps"] for one in compared]


def gap(row: Row) -> float:
    """Return by how much the bound that comes with a plan is above it, relative."""
    return float(row["bound_kbps"] / row["utility_kbps"] - 1)
