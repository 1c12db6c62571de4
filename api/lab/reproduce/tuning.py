"""The letter's last sentence: scan mu, and find one that meets limits on sum rate, fluctuation and fairness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel

from skyfolio.api.lab.reproduce.batch import Advance, silent
from skyfolio.api.lab.reproduce.courses import fly
from skyfolio.planner import Scenario, Utility

MUS = (0.0, *(-(10.0 ** (step / 4)) for step in range(-12, 5)))
"""1/(kbit/s): no penalty, then four values to the decade from 0.001 to 10."""


class Limits(BaseModel):
    """What is asked for; None is not asked. Sum rate in kbit/s, variance of the sum rate in (kbit/s)^2."""

    min_sum_rate_kbps: float | None = None
    max_variance_kbps2: float | None = None
    min_jain: float | None = None


class Row(BaseModel):
    """The figures of merit at one mu: the worst over the losses asked for. `missed` names the limits not met."""

    mu_per_kbps: float
    mean_sum_rate_kbps: float
    variance_kbps2: float
    jain: float
    missed: list[str]


class Tuning(BaseModel):
    """The scan, and the mu chosen from it: of those that meet every limit, the one with the highest sum rate."""

    kind: str
    losses: list[str]
    at_slot: int
    limits: Limits
    rows: list[Row]
    chosen_mu_per_kbps: float | None


def tune(
    scenario: Scenario,
    kind: str,
    limits: Limits,
    *,
    losses: Sequence[str],
    at_slot: int,
    mus: Sequence[float] = MUS,
    advance: Advance = silent,
) -> Tuning:
    """Plan for each mu; for each UAV of `losses` (ids; empty: no loss) replan when it fails at `at_slot` (from 0).

    Raises ValueError for an unknown id or a slot that is not inside the scenario.
    """
    unknown = [uav for uav in losses if uav not in scenario.uav_ids]
    if unknown:
        raise ValueError(f"failed: {unknown[0]!r} must be one of {', '.join(scenario.uav_ids)}")
    if not 0 < at_slot < scenario.slots:
        raise ValueError(f"at_slot: {at_slot} must lie in 1..{scenario.slots - 1}")
    asked: Sequence[str | None] = losses or [None]
    rows = []
    for done, mu in enumerate(mus):
        advance(done, len(mus))
        changed = scenario.with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}))
        courses = [fly(changed, "fast", uav, at_slot).measures() for uav in asked]
        rows.append(
            _row(
                mu,
                limits,
                min(course["mean"] for course in courses),
                max(course["variance"] for course in courses),
                min(course["jain"] for course in courses),
            )
        )
    advance(len(mus), len(mus))
    meeting = [row for row in rows if not row.missed]
    chosen = max(meeting, key=lambda row: row.mean_sum_rate_kbps).mu_per_kbps if meeting else None
    return Tuning(kind=kind, losses=list(losses), at_slot=at_slot, limits=limits, rows=rows, chosen_mu_per_kbps=chosen)


def _row(mu: float, limits: Limits, mean: float, variance: float, jain: float) -> Row:
    missed = []
    if limits.min_sum_rate_kbps is not None and mean < limits.min_sum_rate_kbps:
        missed.append("min_sum_rate")
    if limits.max_variance_kbps2 is not None and variance > limits.max_variance_kbps2:
        missed.append("max_variance")
    if limits.min_jain is not None and jain < limits.min_jain:
        missed.append("min_jain")
    return Row(mu_per_kbps=mu, mean_sum_rate_kbps=mean, variance_kbps2=variance, jain=jain, missed=missed)


def closest(tuning: Tuning) -> Row:
    """Return the row that misses the fewest limits, for the message when none meets them all."""
    return min(tuning.rows, key=lambda row: (len(row.missed), -row.mean_sum_rate_kbps))


def spread(rows: Sequence[Row]) -> dict[str, tuple[float, float]]:
    """Return least and greatest of each measure over the scan: the range that can be reached."""
    table = {
        "min_sum_rate": np.array([row.mean_sum_rate_kbps for row in rows]),
        "max_variance": np.array([row.variance_kbps2 for row in rows]),
        "min_jain": np.array([row.jain for row in rows]),
    }
    return {name: (float(values.min()), float(values.max())) for name, values in table.items()}
