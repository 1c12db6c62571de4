"""What other kinds of channels cost: plans under each against the same scenario under the letter's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.measure import timed
from skyfolio.planner import Plan, Scenario, plan
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.layouts import shadow_map

CHANNELS: dict[str, dict[str, Any]] = {
    "los_probability": {"kind": "los_probability", "noise_figure_db": 9.0},
    "3gpp_uav": {"kind": "3gpp_uav", "noise_figure_db": 9.0},
    "rician, beam": {"noise_dbm": -55.0, "antenna": {"kind": "beam"}},
    "rician, dipole": {"noise_dbm": -55.0, "antenna": {"kind": "dipole"}},
    "map": {"noise_dbm": -55.0},
}
STARTS = 8


def channels(layouts: Sequence[Scenario], effort: Effort) -> dict[str, Any]:
    """Measure whole calls of `plan` from `STARTS` starts, each kind right after the letter's.

    So both are timed on a machine that is about as busy. Times are of processors, and means over layouts: by chance a
    climb takes twice as many passes as another.
    """
    rows = []
    for what, given in CHANNELS.items():
        others = [one.with_changes(channel=_channel(what, given, one, seed)) for seed, one in enumerate(layouts)]
        pairs = [
            (_timed(one, effort, len(layouts)), _timed(other, effort, len(layouts)))
            for one, other in zip(layouts, others, strict=True)
        ]
        plain_ms, cpu_ms = (float(np.mean([pair[i][0]["cpu_p50_ms"] for pair in pairs])) for i in (0, 1))
        gap = float(np.mean([made.summary.gap for _, (_, made) in pairs]))
        rows.append({"what": what, "cpu_ms": cpu_ms, "plain_cpu_ms": plain_ms, "ratio": cpu_ms / plain_ms, "gap": gap})
    return {"layouts": len(layouts), "rows": rows}


def _channel(what: str, given: dict[str, Any], layout: Scenario, seed: int) -> RadioChannel:
    """Return the channel; a map has a receiver at each user, on a grid of 25 m, and shadows of 8 dB."""
    return shadow_map(layout, seed=seed, **given) if what == "map" else channel_of(given)


def _timed(scenario: Scenario, effort: Effort, layouts: int) -> tuple[dict[str, float], Plan]:
    return timed(lambda: plan(scenario, n_starts=STARTS), runs=effort.runs, budget_s=effort.budget_s / layouts)
