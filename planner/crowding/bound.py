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
STAGES = (1, 2, 4, 7, 12, 20)
"""The slots of a stretch that get a bound of their own; those between have the next one's."""
STEPS = 2
"""Of the field, for each of the other stages."""
MOST_LOOKS = 100_000
"""Looks at the field, times classes, times users: some tenths of a second. Beyond, a stretch goes without."""


@dataclass(frozen=True)
class Effort:
    """first, a_uav: steps of the field for the last slot, and more for each UAV; stages: slots before it."""

    first: int
    a_uav: float
    stages: tuple[int, ...]

    def first_steps(self, n_uavs: int) -> int:
        """Return the steps for the last slot of a stretch."""
        return self.first + int(self.a_uav * n_uavs)


OF_A_PLAN, OF_A_REPLAN = Effort(8, 0.6, STAGES), Effort(4, 0.15, ())
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
        looks = effort.first_steps(len(flying)) + STEPS * len(stretch.stages(effort.stages))
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


def first_field(problem: Problem, ground: Ground, slot: Slot, rates_kbps: Array | None) -> Field:
    """Return a field under the standard kappa: of the best served users at the end of a plan, or of users far apart.

    rates_kbps: (K,) of the slot.
    """
    some = min(len(slot.classes), problem.n_users)
    if rates_kbps is None or (rates_kbps > 0.0).sum() < some:
        users = far_apart(ground.user, some)
    else:
        users = np.argpartition(-rates_kbps, some - 1)[:some]
    return Field(ground, standard_repulsion(ground, slot), mass_of(ground, slot, users))


def _bound_stretch(
    problem: Problem, ground: Ground, stretch: Stretch, effort: Effort, rates_kbps: Array | None, bounds: Array
) -> None:
    """Fill in the bounds of a stretch, from its last slot on, in which the fleet is freest."""
    stages = stretch.stages(effort.stages)
    near2, far2 = squared_distance_range(problem, stages, ends=False)
    weights = None if (problem.weight == 1.0).all() else problem.weight
    last = slot_of(problem, ground, int(stages[-1]), near2[:, :, -1], far2[:, :, -1], weights)
    field = first_field(problem, ground, last, None if rates_kbps is None else rates_kbps[:, stages[-1]])
    least = field.improve(everywhere(problem, ground, last, int(stages[-1])), effort.first_steps(len(last.classes)))
    until = stretch.end
    for at in range(len(stages) - 1, -1, -1):
        n = int(stages[at])
        slot = slot_of(problem, ground, n, near2[:, :, at], far2[:, :, at], weights)
        field.renew()
        least = min(least, field.improve(slot, STEPS))
        begin = int(stages[at - 1]) + 1 if at else stretch.first
        bounds[begin:until] = least
        until = begin
