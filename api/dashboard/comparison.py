"""What a loss costs and what a replan regains, over the remaining slots. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyfolio.planner import Plan, delivered_rates_bps
from skyfolio.planner.utility import jain_index

SERVED_BPS = 100.0
"""A user with a lower mean rate counts as not served."""


@dataclass(frozen=True)
class Course:
    """Figures of one alternative over the remaining slots: rates in bit/s, Jain's index of the users' means."""

    mean_sum_rate_bps: float
    worst_mean_bps: float
    unserved: int
    jain: float


def without(plan: Plan, lost: Iterable[str], from_slot: int) -> dict[str, list[float]]:
    """Return each user's rates in bit/s from `from_slot` (operation's grid) on if the survivors flew on as planned."""
    gone = set(lost)
    begin = min(max(from_slot - plan.first_slot, 0), plan.scenario.slots - 1)
    slots = np.arange(begin, plan.scenario.slots)
    uavs = plan.scenario.uav_ids
    positions = np.array([[plan.trajectories_m[uav][n] for uav in uavs] for n in slots], dtype=float)
    transmitting = np.array([[uav not in gone for uav in uavs]] * len(slots))
    rates = delivered_rates_bps(plan, slots, positions, transmitting)
    return {user: [float(rate) for rate in row] for user, row in zip(plan.scenario.user_ids, rates.T, strict=True)}


def course(rates_bps: Mapping[str, Sequence[float]]) -> Course:
    """Return the figures of rates, in bit/s, over the remaining slots."""
    table = np.array([list(row) for row in rates_bps.values()], dtype=float)
    means = table.mean(axis=1)
    return Course(
        mean_sum_rate_bps=float(table.sum(axis=0).mean()),
        worst_mean_bps=float(means.min()),
        unserved=int((means < SERVED_BPS).sum()),
        jain=jain_index(table) if means.any() else 0.0,
    )


def rest(plan: Plan, from_slot: int) -> dict[str, list[float]]:
    """Return each user's planned rates in bit/s from that slot of the operation's grid on."""
    begin = min(max(from_slot - plan.first_slot, 0), plan.scenario.slots - 1)
    return {user: row[begin:] for user, row in plan.user_rates_bps.items()}


def rows(courses: Sequence[Course]) -> list[tuple[str, ...]]:
    """Return the rows of a table with one column for each alternative."""
    return [
        ("mean sum rate, kbit/s", *(f"{course.mean_sum_rate_bps / 1e3:.2f}" for course in courses)),
        ("worst user's mean, kbit/s", *(f"{course.worst_mean_bps / 1e3:.2f}" for course in courses)),
        ("users not served", *(str(course.unserved) for course in courses)),
        ("Jain index", *(f"{course.jain:.3f}" for course in courses)),
    ]
