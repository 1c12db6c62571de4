"""What planning for expected rates gains over planning on the mean channel, and what it takes.

Neither planner knows what will be drawn. Both plans are judged by the simulator's radio (`api/lab/radio.py`): rates at
the planned places under Rician gains drawn for each slot, which no planner has seen, averaged over many seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from rich.table import Table

from skyfolio.api.lab.bench.measure import machine, timed
from skyfolio.api.lab.radio import in_unseen_air
from skyfolio.planner import Plan, Scenario, Utility, delivered_rates_bps, letter, plan
from skyfolio.planner.arrays import Array
from skyfolio.planner.layouts import scattered
from skyfolio.planner.utility import utility_kbps

Row: TypeAlias = dict[str, Any]
DRAWS = (4, 16, 64)
STARTS = 8
"""Climbs of every plan."""
UTILITIES = (
    Utility(kind="sum", mu_per_kbps=0.0),
    Utility(kind="sum", mu_per_kbps=-0.1),
    Utility(kind="pooled", mu_per_kbps=-0.3),
)
FIRST_AIR = 10_000
"""Seeds of the judging draws count from here."""


def radio_figures(layouts: int, air: int, *, large: bool) -> Row:
    """Return the figures of the letter's size on so many layouts, and with `large` of one of 10x100x50.

    air: how many draws of the whole flight judge each plan.
    """
    letters = [letter(layout_seed=seed) for seed in range(layouts)]
    cases = {"3x9x20": letters, **({"10x100x50": [scattered(10, 100, 50, seed=0)]} if large else {})}
    seeds = range(FIRST_AIR, FIRST_AIR + air)
    rows = [_compared(size, scenarios, utility, seeds) for size, scenarios in cases.items() for utility in UTILITIES]
    return {"machine": machine(), "layouts": layouts, "air": air, "rows": [row for some in rows for row in some]}


def _compared(size: str, scenarios: Sequence[Scenario], utility: Utility, seeds: Sequence[int]) -> list[Row]:
    """Return one row for each channel that is planned for; gains are on the mean over layouts, with 95 % intervals."""
    found = {draws: [_judged(scenario, utility, draws, seeds) for scenario in scenarios] for draws in (0, *DRAWS)}
    spent = {draws: _cpu_ms(scenarios[0], utility, draws) for draws in found}
    rows = []
    for draws, judged in found.items():
        rate, worth = (
            [100 * (one[key] / base[key] - 1) for one, base in zip(judged, found[0], strict=True)]
            for key in ("achieved_kbps", "achieved_utility_kbps")
        )
        means = {key: float(np.mean([one[key] for one in judged])) for key in judged[0]}
        gains = {"rate_gain_percent": _interval(rate), "utility_gain_percent": _interval(worth)}
        name = f"{utility.kind}, mu = {utility.mu_per_kbps:g}"
        rows.append({"size": size, "utility": name, "draws": draws, "cpu_ms": spent[draws], **means, **gains})
    return rows


def _judged(scenario: Scenario, utility: Utility, draws: int, seeds: Sequence[int]) -> dict[str, float]:
    """Return promise and achievement of a plan for so many draws; 0: for the mean channel."""
    made = plan(_told(scenario, utility, draws), n_starts=STARTS)
    rates = achieved_kbps(made, seeds)
    return {
        "promised_kbps": made.summary.mean_sum_rate_bps / 1e3,
        "achieved_kbps": float(rates.sum(axis=0).mean()),
        "achieved_utility_kbps": utility_kbps(rates, utility.kind, utility.mu_per_kbps),
    }


def _cpu_ms(scenario: Scenario, utility: Utility, draws: int) -> float:
    """Return the processor time of such a plan, ms."""
    told = _told(scenario, utility, draws)
    return float(timed(lambda: plan(told, n_starts=STARTS), runs=3, budget_s=1.0)[0]["cpu_p50_ms"])


def _told(scenario: Scenario, utility: Utility, draws: int) -> Scenario:
    """Return the scenario with what the planner is to know of its channel."""
    told = {"fading": "expected", "draws": draws} if draws else {"fading": "mean"}
    return scenario.with_changes(utility=utility, channel=scenario.channel.model_copy(update=told))


def achieved_kbps(made: Plan, seeds: Sequence[int]) -> Array:
    """Return what users get at the planned places, the mean over these draws of the air: (K, N) kbit/s."""
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    slots = np.arange(made.scenario.slots)
    sending = np.ones((len(slots), len(paths)), dtype=bool)
    total = np.zeros((len(made.scenario.users), len(slots)))
    for seed in seeds:
        total += delivered_rates_bps(in_unseen_air(made, seed), slots, paths.transpose(1, 0, 2), sending).T / 1e3
    return total / len(seeds)


def _interval(values: Sequence[float]) -> list[float]:
    """Return the mean, and half its 95 % interval over layouts (twice the standard error; 0 of one layout)."""
    n = len(values)
    return [float(np.mean(values)), 2.0 * float(np.std(values, ddof=1)) / n**0.5 if n > 1 else 0.0]


def table(figures: Row) -> Table:
    """Return promise, achievement, gain over planning on the mean channel, and processor time."""
    columns = ("U x K x N", "utility", "planned for", "promised", "achieved", "gain", "gain in utility", "CPU ms")
    shown = Table(
        *columns, title=f"rates in kbit/s, judged by {figures['air']} unseen draws, {figures['layouts']} layouts"
    )
    for row in figures["rows"]:
        gains = (
            f"{mean:+.2f} % ± {half:.2f}" for mean, half in (row["rate_gain_percent"], row["utility_gain_percent"])
        )
        what = f"{row['draws']} draws" if row["draws"] else "the mean channel"
        rates = (f"{row[key]:.2f}" for key in ("promised_kbps", "achieved_kbps"))
        shown.add_row(row["size"], row["utility"], what, *rates, *gains, f"{row['cpu_ms']:.0f}")
    return shown
