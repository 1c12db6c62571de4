"""Plans over hills beside the same ones over level ground: what they take, and what they are worth."""

from __future__ import annotations

from typing import Any

import numpy as np

from skyfolio.api.lab.bench.calls import timed_calls
from skyfolio.api.lab.bench.cases import instance
from skyfolio.api.lab.bench.effort import Effort, class_of
from skyfolio.api.lab.bench.hilly import hills
from skyfolio.api.lab.bench.instances import Size
from skyfolio.planner import Scenario

CLEARANCE_M = 30.0
HIGHEST_M = 120.0
"""Above the ground, of altitudes that are chosen; the least is the one that is kept otherwise."""
CASES = ("level", "terrain", "altitudes")
CALLS = ("plan_call", "replan_call")


def over_terrain(level: Scenario, seed: int) -> Scenario:
    """Return the scenario over random hills, each UAV as low as it may fly."""
    return level.with_changes(terrain=hills(level, np.random.default_rng(seed)), clearance_m=CLEARANCE_M)


def with_altitudes(hilly: Scenario) -> Scenario:
    """Return the scenario with altitudes that are chosen."""
    return hilly.with_changes(altitude_max_m=HIGHEST_M)


def terrain(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure `planner.plan` and `planner.replan` over level ground, over hills, and with altitudes chosen there.

    The three of one layout come right after each other, on a machine that is about as busy. Times are of processors,
    and means over layouts; ratios are to level ground.
    """
    layouts = effort.ground_layouts[class_of(size)]
    rows = [_layout(size, kind, seed, effort, 1.0 / layouts) for seed in range(1, 1 + layouts)]
    figures: dict[str, Any] = {"layouts": layouts}
    for name in CASES:
        of_case: dict[str, Any] = {"utility_kbps": _mean([row[name]["utility_kbps"] for row in rows])}
        for call in CALLS:
            of_case[call] = {"cpu_p50_ms": _mean([row[name][call]["cpu_p50_ms"] for row in rows])}
        figures[name] = of_case
    for name in CASES[1:]:
        for call in CALLS:
            figures[name][call]["ratio"] = figures[name][call]["cpu_p50_ms"] / figures["level"][call]["cpu_p50_ms"]
    return figures


def _layout(size: Size, kind: str, seed: int, effort: Effort, share: float) -> dict[str, Any]:
    level = instance(size, kind, seed)
    hilly = over_terrain(level, seed)
    scenarios = zip(CASES, (level, hilly, with_altitudes(hilly)), strict=True)
    return {name: timed_calls(scenario, effort, share)[0] for name, scenario in scenarios}


def _mean(values: list[float]) -> float:
    return float(np.mean(values))
