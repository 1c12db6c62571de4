"""The crowding bound of all slots, as cheap as a plan can wait for: a standard kappa, and few steps of the field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.slots import Ground, Slot, everywhere, ground_of, slot_of
from skyfolio.planner.crowding.standard import far_apart, mass_of, standard_repulsion
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range

Ints: TypeAlias = NDArray[np.int64]
MOST_LOOKS = 400_000
"""Looks at the field, times classes, times users: some tenths of a second. Beyond, a stretch goes without."""


@dataclass(frozen=True)
class Effort:
    """first: steps of the field for a fleet that can be anywhere.

    stages: slots of a stretch that get a bound of their own beside its last one; those between have the next one's.
    then: steps for each of them.
    """

    first: int
    stages: tuple[int, ...]
    then: int

    def looks(self, n_stages: int) -> int:
        """Return how often the field is looked at."""
        return self.first + self.then * n_stages


OF_A_PLAN, OF_A_REPLAN = Effort(50, (1, 2, 4, 7, 12, 20), 2), Effort(30, (), 0)
"""A fleet in flight waits for its replan: it gets by with a few hundredths more of a gap, in a third of the time."""


@dataclass(frozen=True)
class Stretch:
    """Slots [first, end) in which the same UAVs fly under the same gains: what they reach from their starts grows."""

    first: int
    end: int

    def stages(self, among: tuple[int, ...]) -> Ints:
        """Return which of these slots get a bound of their own, and the last one."""
        slots = [n for n in among if self.first < n < self.end - 1]
        return np.array([*slots, self.end - 1], dtype=np.int64)


def crowded_slot_bounds_kbps(problem: Problem, rates_kbps: Array | None = None) -> Array:
    """Return upper bounds of the weighted sum rate of each slot: (N,) kbit/s, infinite where that would take too long.

    Users count as if they were always there, which none can be worse for.
    rates_kbps: (K, N) of a good plan, whose served users make a good first field; any will do.
    """
    bounds = np.full(problem.n_slots, np.inf)
    if problem.n_users < 2:
        return bounds
    ground = ground_of(problem)
    effort = OF_A_REPLAN if problem.past_kbps.shape[1] else OF_A_PLAN
    looks_left = MOST_LOOKS
    for stretch in reversed(stretches_of(problem, ground)):
        flying = np.flatnonzero(problem.flying[:, stretch.first])
        looks = effort.looks(len(stretch.stages(effort.stages)))
        looks_left -= looks * problem.n_users * len(np.unique(ground.classes[flying]))
        if looks_left < 0:
            break
        if len(flying) > 1:
            _bound_stretch(problem, ground, stretch, effort, rates_kbps, bounds)
    return bounds


def stretches_of(problem: Problem, ground: Ground) -> list[Stretch]:
    """Return the stretches from first to last slot: one for each slot when fading is sampled."""
    changes = {int(n) for n in problem.n_flying if n < problem.n_slots} if ground.alike else range(problem.n_slots)
    begins = sorted({0, *changes})
    return [Stretch(first, end) for first, end in zip(begins, [*begins[1:], problem.n_slots], strict=True)]


def first_field(ground: Ground, slot: Slot, rates_kbps: Array | None) -> Field:
    """Return a field under the standard kappa: of the best served users at the end of a plan, or of users far apart.

    rates_kbps: (K,) of the slot.
    """
    apart = far_apart(ground.user, min(slot.n_uavs, len(ground.user)))
    gain = float(np.median(slot.links.power))
    users = apart
    if rates_kbps is not None and (rates_kbps > 0.0).sum() >= len(apart):
        users = np.argpartition(-rates_kbps, len(apart) - 1)[: len(apart)]
    mass = mass_of(ground, gain, slot.links.scale[0, users], users)
    return Field(ground, standard_repulsion(ground, gain, apart), mass)


def _bound_stretch(
    problem: Problem, ground: Ground, stretch: Stretch, effort: Effort, rates_kbps: Array | None, bounds: Array
) -> None:
    """Fill in the bounds of a stretch, from its last slot on, in which the fleet is freest."""
    weights = None if (problem.weight == 1.0).all() else problem.weight
    last = everywhere(problem, ground, stretch.end - 1, weights)
    field = first_field(ground, last, None if rates_kbps is None else rates_kbps[:, stretch.end - 1])
    least = field.improve(last, effort.first)
    bounds[stretch.first : stretch.end] = least
    stages = stretch.stages(effort.stages)
    if not effort.then:
        return
    near2, far2 = squared_distance_range(problem, stages, ends=False)
    for at in range(len(stages) - 1, -1, -1):  # what is true of a slot is true of those before: less can be reached
        slot = slot_of(problem, ground, int(stages[at]), near2[:, :, at], far2[:, :, at], weights)
        field.renew()
        least = min(least, field.improve(slot, effort.then))
        bounds[stretch.first : int(stages[at]) + 1] = least
