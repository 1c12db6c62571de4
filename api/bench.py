"""Measurements of the planner."""

from __future__ import annotations

import platform
import time
from statistics import median
from typing import Any

from rich.table import Table

from planner import EXAMPLES, plan, replan


def planner_figures(runs: int) -> dict[str, Any]:
    """Milliseconds of a whole plan and of a replan after a loss on the paper scenario, warm, and what they reach."""
    scenario = EXAMPLES["paper"]()
    made = plan(scenario)
    lost = scenario.uav_ids[-1]
    cold, warm, again = [], [], made
    for _ in range(runs):
        began = time.perf_counter()
        made = plan(scenario)
        cold.append((time.perf_counter() - began) * 1e3)
        began = time.perf_counter()
        again = replan(made, failed=[lost], at_slot=scenario.slots // 2)
        warm.append((time.perf_counter() - began) * 1e3)
    return {
        "machine": {"processor": platform.processor() or platform.machine(), "python": platform.python_version()},
        "runs": runs,
        "rows": [
            {"what": "plan", "p50_ms": median(cold), "max_ms": max(cold), "utility_bps": made.summary.utility_bps},
            {"what": "replan", "p50_ms": median(warm), "max_ms": max(warm), "utility_bps": again.summary.utility_bps},
        ],
    }


def table(figures: dict[str, Any]) -> Table:
    """The figures for the eye."""
    shown = Table("what", "p50, ms", "max, ms", "utility, kbit/s", title="planner, 3 UAVs x 9 users x 20 slots")
    for row in figures["rows"]:
        shown.add_row(row["what"], f"{row['p50_ms']:.1f}", f"{row['max_ms']:.1f}", f"{row['utility_bps'] / 1e3:.2f}")
    return shown
