"""What keeps a sweep from being faster, from measured shares of the cores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

CORES = "cores"
IDLE = "workers that wait"
ENGINE = "scheduler and client"
SLOWER = "slower cores: caches, memory, switching"
OTHERS = "other programs"
USED_UP = 0.1
"""Cores that are idle for a smaller share than this are used up."""


def with_limits(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows, each with its speed-up over the first and with what limits it.

    Core seconds are split into those that the cases need (as many as in the first row), those by which the same cases
    took longer (two cores share caches and memory, workers share a core), those of scheduler and client with all
    pickling, those of other programs, and idle ones. `lost`: the share of each. `limit`: the cores where hardly any is
    idle and the cases have the largest share; else the largest loss.
    """
    return [{**row, "speedup": row["cases_per_s"] / rows[0]["cases_per_s"], **_limit(row, rows[0])} for row in rows]


def _limit(row: dict[str, Any], first: dict[str, Any]) -> dict[str, Any]:
    per_case_s = first["cpu_ms_per_case"] / 1e3
    used = row["cases_per_s"] * per_case_s / row["cores"]
    longer = row["cases_per_s"] * (row["cpu_ms_per_case"] / 1e3 - per_case_s) / row["cores"]
    lost = {
        SLOWER: max(0.0, longer),
        ENGINE: row["engine_share"],
        OTHERS: row["others_share"],
        IDLE: row["idle_share"],
    }
    worst = max(lost, key=lambda name: lost[name])
    limit = CORES if row["idle_share"] < USED_UP and used >= lost[worst] else worst
    return {"used": used, "lost": lost, "limit": limit}
