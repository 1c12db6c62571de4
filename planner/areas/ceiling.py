"""The certificate of a large fleet: the crowding bound of all UAVs in the whole area, slot by slot and lean.

Areas are how plans are found; the bound is of the whole fleet, and holds for plans that were found in any way. A slot
is bounded as if everybody could be anywhere by then (`crowding`), with a field that begins at the users who are served
in a good plan. In the first slots little can be reached, and each UAV gets at most what its best user can get within
reach, all others as far away as they can be: without the rule that users are distinct, which hardly matters there.
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import optimistic_rates_kbps
from skyfolio.planner.crowding.bound import first_field, stretches_of
from skyfolio.planner.crowding.slots import everywhere, ground_of, slot_of
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range

STEPS = 40
"""Of the field, for each stretch in which the same UAVs fly."""
MOST_STRETCHES = 4
"""UAVs that leave make a stretch of their own; with more than so many, the later ones are bounded by reach alone."""


def slot_ceilings_kbps(problem: Problem, rates_kbps: Array | None = None) -> Array:
    """Return upper bounds of the sum rate of each slot of a fleet on the mean channel: (N,) kbit/s.

    rates_kbps: (K, N) of a good plan; any will do. At most two tables of U K numbers are made at a time.
    """
    bounds = np.full(problem.n_slots, np.inf)
    if problem.n_users >= 2:
        _crowd(problem, rates_kbps, bounds)
    for n in range(problem.n_slots):
        reached = float(optimistic_rates_kbps(problem, np.array([n])).max(axis=1).sum())
        if reached > bounds[n]:
            break
        bounds[n] = reached
    return bounds


def _crowd(problem: Problem, rates_kbps: Array | None, bounds: Array) -> None:
    ground = ground_of(problem)
    stretches = stretches_of(problem, ground)
    for stretch in stretches[:MOST_STRETCHES]:
        n = stretch.end - 1
        if problem.flying[:, n].sum() < 2:
            continue
        near2, far2 = squared_distance_range(problem, np.array([n]), ends=False)
        slot = everywhere(problem, ground, slot_of(problem, ground, n, near2[:, :, 0], far2[:, :, 0]), n)
        del near2, far2
        field = first_field(problem, ground, slot, None if rates_kbps is None else rates_kbps[:, n])
        bounds[stretch.first : stretch.end] = field.improve(slot, STEPS)
