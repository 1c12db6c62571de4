"""True rates of users while a plan is flown: true positions, and a fading draw the planner has not seen.

The planner knows the channel's statistics, or one draw of it; the air draws anew. Same plan, positions and seed, same
rates. The sums are `planner.delivered_rates_bps` (eqs. 3 and 4), on another draw of eq. (2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skyfolio import sim
from skyfolio.api.flights.rates import InForce, Sample, rates_by_slot
from skyfolio.mavlink_bridge import geodetic_to_east_north
from skyfolio.planner import Plan
from skyfolio.planner.arrays import Array


def in_unseen_air(plan: Plan, seed: int) -> Plan:
    """Return the plan under a Rician draw from `seed`, whatever fading it was made for."""
    channel = plan.scenario.channel.model_copy(update={"fading": "sampled", "seed": seed, "corrections_db": {}})
    return plan.model_copy(update={"scenario": plan.scenario.model_copy(update={"channel": channel})})


def true_rates_bps(timeline: Sequence[InForce], samples: Sequence[Sample], n_slots: int, *, seed: int) -> Array:
    """Mean rate of each user in each slot: (K, n_slots) bit/s; NaN for slots without a sample."""
    unseen = [InForce(entry.from_s, in_unseen_air(entry.plan, seed)) for entry in timeline]
    return rates_by_slot(unseen, samples, n_slots)


class RadioTruth:
    """Watches a simulated fleet fly one plan, and reports each slot's rates when the slot is over.

    `uav_of` gives the UAV of a system id. A UAV that is dead, standing, or silent serves no user.
    """

    def __init__(self, plan: Plan, uav_of: Mapping[int, str], *, seed: int) -> None:
        self.plan = plan
        self._timeline = [InForce(0.0, plan)]
        self._uav_of = uav_of
        self._seed = seed
        self._slot = 0

    def rows(self, fleet: sim.Fleet) -> list[dict[str, Any]]:
        """Rows for the truth log, one for each slot that ended since the last call."""
        grid = fleet.slots
        if grid is None:
            return []
        over = min(grid.slot_at(fleet.now_s), self.plan.scenario.slots)
        if over <= self._slot:
            return []
        first, self._slot = self._slot, over
        samples = self._samples(fleet, grid, first, over)
        rates = true_rates_bps(self._timeline, samples, over, seed=self._seed)
        return [
            {
                "log": "rates",
                "t_s": grid.begins_s(slot + 1),
                "slot": slot,
                "user_rates_bps": _by_user(self.plan, rates[:, slot]),
            }
            for slot in range(first, over)
        ]

    def _samples(self, fleet: sim.Fleet, grid: sim.SlotGrid, first: int, over: int) -> list[Sample]:
        origin = self.plan.scenario.origin
        instants: dict[float, dict[str, tuple[tuple[float, float], bool]]] = {}
        for row in reversed(fleet.truth.samples):
            if row.t_s < grid.begins_s(first):
                break
            if row.t_s < grid.begins_s(over) and row.system_id in self._uav_of:
                where = geodetic_to_east_north(origin, row.lat_deg, row.lon_deg)
                on = row.alive and row.transmitting and row.relative_alt_m > 0.0
                instants.setdefault(row.t_s, {})[self._uav_of[row.system_id]] = (where, on)
        return [
            Sample(
                t_s - grid.start_s,
                {uav: where for uav, (where, _) in here.items()},
                frozenset(uav for uav, (_, on) in here.items() if on),
            )
            for t_s, here in sorted(instants.items())
        ]


def _by_user(plan: Plan, rates_bps: Array) -> dict[str, float | None]:
    ids = plan.scenario.user_ids
    return {user: None if np.isnan(rate) else round(float(rate), 3) for user, rate in zip(ids, rates_bps, strict=True)}
