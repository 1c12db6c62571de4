"""The certificate of a large fleet: the crowding bound of all UAVs in the whole area, slot by slot and lean.

Areas are how plans are found; the bound is of the whole fleet, and holds for plans that were found in any way. A slot
is bounded as if everybody could be anywhere by then (`crowding`), with a field that begins at the users who are served
in a good plan; a few of the earlier ones with what can be reached by then. In the first slots little can be reached,
and each UAV gets at most what its best user can get within reach, all others as far away as they can be: without the
rule that users are distinct, which hardly matters there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.bound import Stretch, first_field, stretches_of
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import sharpened
from skyfolio.planner.crowding.slots import Ground, Slot, everywhere, ground_of, slot_of
from skyfolio.planner.optimistic import optimistic_rates_kbps
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range

STEPS = 40
"""Of the field, for each stretch in which the same UAVs fly, and under each further kappa."""
KAPPAS, LAST_STEPS = 24, 120
"""How many kappas more a proof tries, and steps under the best one."""
STAGES, STAGE_STEPS = (20, 12, 7), 2
"""Slots that are bounded with what can be reached by then, and steps of the field for each."""
USERS_AT_ONCE = 500
"""So that tables of all UAVs and these users stay in the processor's cache."""
MOST_STRETCHES = 4
"""UAVs that leave make a stretch of their own; with more than so many, the later ones are bounded by reach alone."""


def slot_ceilings_kbps(problem: Problem, rates_kbps: Array | None = None) -> Array:
    """Return upper bounds of the sum rate of each slot of a fleet on the mean channel: (N,) kbit/s.

    rates_kbps: (K, N) of a good plan; any will do. At most two tables of U K numbers are made at a time.
    """
    bounds = np.full(problem.n_slots, np.inf)
    _crowd(problem, rates_kbps, bounds)
    for n in range(problem.n_slots):
        reached = _reached_kbps(problem, n)
        if reached > bounds[n]:
            break
        bounds[n] = reached
    return bounds


def _reached_kbps(problem: Problem, n: int) -> float:
    """Return what all UAVs have at most in slot n, each with the best user in reach; some users at a time."""
    best = np.zeros(problem.n_uavs)
    for users in np.array_split(np.arange(problem.n_users), -(-problem.n_users // USERS_AT_ONCE)):
        rates = optimistic_rates_kbps(problem.only(users=users), np.array([n]))
        np.maximum(best, rates.max(axis=(1, 2)), out=best)
    return float(best.sum())


def lower_ceilings(
    problem: Problem, rates_kbps: Array, bounds: Array, stop: Callable[[], bool], told: Callable[[], None]
) -> tuple[int, bool]:
    """Lower bounds (N,) of the slots' sum rates in place by further kappas, until nothing is left to try.

    stop: asked between two kappas. told: called after each stretch. Return how many assignments were looked at, and
    whether there was time for all.
    """
    looks, ground = 0, ground_of(problem)
    for stretch, slot, field in _stretches(problem, rates_kbps, ground):
        if stop():
            return looks, False
        least, best = sharpened(field, slot, KAPPAS, STEPS, stop=stop)
        if not stop():
            least = min(least, best.improve(slot, LAST_STEPS))
        looks += (KAPPAS + 1) * STEPS + LAST_STEPS
        bounds[stretch.first : stretch.end] = np.minimum(bounds[stretch.first : stretch.end], least)
        told()
    return looks, not stop()


def _crowd(problem: Problem, rates_kbps: Array | None, bounds: Array) -> None:
    ground = ground_of(problem)
    for stretch, slot, field in _stretches(problem, rates_kbps, ground):
        least = field.improve(slot, STEPS)
        bounds[stretch.first : stretch.end] = least
        for n in STAGES:  # what can be reached grows: what is true of a slot is true of those before
            if stretch.first < n < stretch.end - 1:
                field.renew()
                least = min(least, field.improve(_reached_slot(problem, ground, n), STAGE_STEPS))
                bounds[stretch.first : n + 1] = least


def _stretches(problem: Problem, rates_kbps: Array | None, ground: Ground) -> Iterator[tuple[Stretch, Slot, Field]]:
    """Yield the first stretches: each with its last slot, as if all could be anywhere, and a field to begin with."""
    if problem.n_users < 2:
        return
    for stretch in stretches_of(problem, ground)[:MOST_STRETCHES]:
        n = stretch.end - 1
        if problem.flying[:, n].sum() < 2:
            continue
        slot = everywhere(problem, ground, n)
        yield stretch, slot, first_field(ground, slot, None if rates_kbps is None else rates_kbps[:, n])


def _reached_slot(problem: Problem, ground: Ground, n: int) -> Slot:
    near2, far2 = squared_distance_range(problem, np.array([n]), ends=False)
    return slot_of(problem, ground, n, near2[:, :, 0], far2[:, :, 0])
