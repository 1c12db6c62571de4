"""Percentiles and outages of many draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.robustness.findings import Percentiles
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.tracks import absences_of, demands_bps
from skyfolio.planner.utility import SATED

DUST_BPS = 1e-6
"""A rate below this is none."""


def thresholds_bps(scenario: Scenario, planned_bps: Array, share: float, outage_bps: float | None) -> Array:
    """Return below which rate a user is in outage, by slot: (K, N) bit/s, NaN for slots that do not count.

    outage_bps counts in every slot, or what a user asks for where that is less; without it a user's `min_rate_bps`
    does, and for users that have none `share` of what was planned, in the slots in which something was. Slots in which
    a user is not there do not count.
    """
    there, enough = ~absences_of(scenario), demands_bps(scenario)[:, None] * (1.0 - SATED)
    if outage_bps is not None:
        return np.where(there, np.minimum(outage_bps, enough), np.nan)
    least = np.array([user.min_rate_bps for user in scenario.users])[:, None]
    relative = np.where(planned_bps > DUST_BPS, share * planned_bps, np.nan)
    thresholds: Array = np.where(there, np.where(least > 0.0, least, relative), np.nan)
    return thresholds


class Tally:
    """Counts draws of one operation, whose slots from `from_slot` on matter. thresholds_bps: (K, N)."""

    def __init__(self, thresholds_bps: Array, from_slot: int = 0) -> None:
        self._from = from_slot
        self._thresholds = thresholds_bps[:, from_slot:]
        self._counts: NDArray[np.intp] = np.isfinite(self._thresholds).sum(axis=1)
        self._short = np.zeros(len(thresholds_bps), dtype=np.intp)
        self._means: list[Array] = []

    @property
    def draws(self) -> int:
        """Return how many draws were counted."""
        return len(self._means)

    def add(self, rates_bps: Array) -> None:
        """Count a draw: (K, N) bit/s."""
        rates = rates_bps[:, self._from :]
        self._short += (rates < self._thresholds).sum(axis=1)  # a comparison with NaN is false
        self._means.append(rates.mean(axis=1))

    def users(self) -> list[Percentiles]:
        """Return the mean rate of each user over the draws."""
        return [percentiles(row) for row in np.array(self._means).T]

    def sums(self) -> Array:
        """Return the mean sum rate of each draw: (D,) bit/s."""
        total: Array = np.array(self._means).sum(axis=1)
        return total

    def outages(self) -> list[float | None]:
        """Return the outage probability of each user, None where no slot counts."""
        return [
            float(short) / (int(count) * self.draws) if count else None
            for short, count in zip(self._short, self._counts, strict=True)
        ]

    def outage(self) -> float | None:
        """Return the outage probability over all users, None where no slot counts."""
        count = int(self._counts.sum())
        return float(self._short.sum()) / (count * self.draws) if count else None


def percentiles(values_bps: Array) -> Percentiles:
    """Return the percentiles of one value per draw."""
    p5, p50, p95 = np.percentile(values_bps, [5, 50, 95])
    return Percentiles(
        p5_bps=float(p5),
        p50_bps=float(p50),
        p95_bps=float(p95),
        mean_bps=float(values_bps.mean()),
        least_bps=float(values_bps.min()),
    )
