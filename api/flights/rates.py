"""What users got in flight: samples of true or reported positions, and the plan that was in force."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skyfolio.planner import Plan
from skyfolio.planner.arrays import Array
from skyfolio.planner.delivered import Delivery
from skyfolio.planner.geometry import Point

AT_ONCE = 64
"""Samples that are evaluated together: arrays of (samples, UAVs, users) are what takes the memory."""


@dataclass(frozen=True)
class Sample:
    """Where UAVs were and which of them served, `elapsed_s` fleet seconds after slot 0 began; metres east/north."""

    elapsed_s: float
    positions_m: Mapping[str, Point]
    transmitting: frozenset[str]


@dataclass(frozen=True)
class InForce:
    """A plan that users follow from `from_s` fleet seconds on, until the next entry of the timeline."""

    from_s: float
    plan: Plan

    @cached_property
    def delivery(self) -> Delivery:
        """Return the rates of this plan wherever its UAVs are."""
        return Delivery(self.plan)


def rates_by_sample(timeline: Sequence[InForce], samples: Sequence[Sample]) -> Array:
    """Return the rate of each user at each sample: (S, K) bit/s, users in the order of the first plan's scenario."""
    starts = [entry.from_s for entry in timeline]
    rates = np.zeros((len(samples), len(timeline[0].plan.scenario.users)))
    entry_of = [max(bisect_right(starts, sample.elapsed_s) - 1, 0) for sample in samples]
    for number, entry in enumerate(timeline):
        rows = [row for row, chosen in enumerate(entry_of) if chosen == number]
        for begin in range(0, len(rows), AT_ONCE):
            batch = rows[begin : begin + AT_ONCE]
            rates[batch] = _rates_under(entry, [samples[row] for row in batch])
    return rates


def rates_by_slot(timeline: Sequence[InForce], samples: Sequence[Sample], n_slots: int) -> Array:
    """Return the mean rate of each user in each slot: (K, n_slots) bit/s; NaN for slots without a sample."""
    slot_s = timeline[0].plan.scenario.slot_duration_s
    by_sample = rates_by_sample(timeline, samples)
    slots = np.array([int(sample.elapsed_s // slot_s) for sample in samples], dtype=int)
    table = np.full((by_sample.shape[1], n_slots), np.nan)
    for n in range(n_slots):
        if (slots == n).any():
            table[:, n] = by_sample[slots == n].mean(axis=0)
    return table


def _rates_under(entry: InForce, samples: Sequence[Sample]) -> Array:
    plan, scenario = entry.plan, entry.plan.scenario
    last = scenario.slots - 1
    local = [int(sample.elapsed_s // scenario.slot_duration_s) - plan.first_slot for sample in samples]
    slots = np.clip(np.array(local, dtype=np.intp), 0, last)
    planned = {uav: plan.trajectories_m[uav] for uav in scenario.uav_ids}
    positions = np.array(
        [
            [sample.positions_m.get(uav, planned[uav][slot]) for uav in scenario.uav_ids]
            for sample, slot in zip(samples, slots, strict=True)
        ],
        dtype=float,
    )
    transmitting = np.array([[uav in sample.transmitting for uav in scenario.uav_ids] for sample in samples])
    return entry.delivery.rates_bps(slots, positions, transmitting)
