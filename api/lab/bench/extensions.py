"""What users beyond the letter's cost: tracks, windows, weights and demands against the same scenario without them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.measure import timed
from skyfolio.planner import Plan, Scenario, User, plan

WALK_M = 4.0
"""Steps of the tracks in one slot, metres."""


def extended(scenario: Scenario, what: str) -> Scenario:
    """Return the scenario with users of this kind: `tracks`, `windows`, `weights` or `demands`; seeded."""
    rng = np.random.default_rng(1)
    return scenario.with_changes(users=tuple(_extended(user, what, scenario.slots, rng) for user in scenario.users))


EXTENSIONS = ("tracks", "windows", "weights", "demands")


def _extended(user: User, what: str, n_slots: int, rng: np.random.Generator) -> User:
    if what == "tracks":
        steps = rng.normal(0.0, WALK_M, (n_slots - 1, 2)).cumsum(axis=0)
        east, north = user.position_m
        track = [user.position_m, *((east + e, north + n) for e, n in steps.tolist())]
        return user.model_copy(update={"positions_m": tuple(track), "uncertainty_mps": 0.1})
    if what == "windows":
        came = int(rng.integers(0, n_slots // 2))
        return user.model_copy(update={"arrives_at_slot": came, "leaves_at_slot": came + n_slots // 2})
    if what == "weights":
        return user.model_copy(update={"weight": float(rng.integers(1, 4))})
    return user.model_copy(update={"demand_bps": float(rng.uniform(3e3, 3e4))})


def extensions(layouts: Sequence[Scenario], effort: Effort) -> dict[str, Any]:
    """Measure whole calls of `plan` from one start, each kind of users right after users of the letter.

    So both are timed on a machine that is about as busy. Times are of processors, and means over layouts: by chance a
    climb takes twice as many passes as another.
    """
    rows = []
    for what in EXTENSIONS:
        pairs = [
            (_timed(one, effort, len(layouts)), _timed(extended(one, what), effort, len(layouts))) for one in layouts
        ]
        plain_ms, cpu_ms = (float(np.mean([pair[i][0]["cpu_p50_ms"] for pair in pairs])) for i in (0, 1))
        gap = float(np.mean([made.summary.gap for _, (_, made) in pairs]))
        rows.append({"what": what, "cpu_ms": cpu_ms, "plain_cpu_ms": plain_ms, "ratio": cpu_ms / plain_ms, "gap": gap})
    return {"layouts": len(layouts), "rows": rows}


def _timed(scenario: Scenario, effort: Effort, layouts: int) -> tuple[dict[str, float], Plan]:
    return timed(lambda: plan(scenario, n_starts=1), runs=effort.runs, budget_s=effort.budget_s / layouts)
