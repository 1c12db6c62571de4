"""What the users of a drill truly got from base stations: measured, where it was, in the place of what is computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from skyfolio.api.lab.demo.report import UNSERVED_BPS
from skyfolio.planner import Plan, Scenario
from skyfolio.planner.arrays import Array

Received: TypeAlias = Sequence[tuple[float, Mapping[str, float]]]
"""Bit/s of every user that got something, at seconds since slot 0, in order."""


def measured_over(computed_bps: Array, received: Received, scenario: Scenario) -> tuple[Array, list[int]]:
    """Return the rates of slots, (K, N) bit/s, with the mean of what was measured in each slot in which it was.

    Also return these slots.
    """
    slots: dict[int, list[Mapping[str, float]]] = {}
    for at_s, rates in received:
        slots.setdefault(int(at_s // scenario.slot_duration_s), []).append(rates)
    measured = sorted(slot for slot in slots if slot < scenario.slots)
    rates_bps = computed_bps.copy()
    for slot in measured:
        rates_bps[:, slot] = [np.mean([one.get(user, 0.0) for one in slots[slot]]) for user in scenario.user_ids]
    return rates_bps, measured


def sums(received: Received) -> tuple[Array, Array]:
    """Return the moments, seconds since slot 0, and the sum rate at each, bit/s."""
    return np.array([at for at, _ in received]), np.array([sum(rates.values()) for _, rates in received])


def without_service_s(plan: Plan, lost: str, lost_at_s: float, received: Received) -> float | None:
    """Return for how many seconds the users of a lost UAV had no service, on average, until somebody served them.

    plan: whom it served. None where nothing was measured after the loss, or it served no user.
    """
    slot_s, n_slots = plan.scenario.slot_duration_s, plan.scenario.slots
    slot = min(int(lost_at_s // slot_s), n_slots - 1)
    users = [user for user, row in plan.association.items() if row[slot] == lost and plan.bandwidth_hz[user][slot] > 0]
    after = [(at, rates) for at, rates in received if at >= lost_at_s]
    if not users or not after:
        return None
    return float(np.mean([_gap_s(user, lost_at_s, n_slots * slot_s, after) for user in users]))


def _gap_s(user: str, lost_at_s: float, end_s: float, after: Received) -> float:
    dark = [at for at, rates in after if rates.get(user, 0.0) < UNSERVED_BPS]
    if not dark:
        return 0.0
    again = (at for at, rates in after if at > dark[0] and rates.get(user, 0.0) >= UNSERVED_BPS)
    return next(again, end_s) - lost_at_s
