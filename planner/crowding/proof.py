"""The crowding bound made tight, offline, for any fleet: kappas for every slot, and steps until they settle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.bound import first_field, stretches_of
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import AGE, sharpened
from skyfolio.planner.crowding.slots import Ground, Slot, everywhere, ground_of, slot_of
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range


class Visit(NamedTuple):
    """What a slot gets when it is its turn: how many kappas more, and steps under each. coarse: only some slots."""

    kappas: int
    steps: int
    coarse: bool = False


FREE, LAST_STEPS = Visit(24, 100), 600
"""For a fleet that can be anywhere, and how many steps more under the best kappa."""
VISITS = (Visit(0, 60, coarse=True), Visit(4, 30, coarse=True), Visit(0, 60), Visit(3, 60))
"""For each slot in turn, the first time, the second time, and so on. A field that has settled shows better kappas."""
AGAIN = Visit(4, 100)
"""For the slot that gained most the last time, as long as any gains."""
LEAST_GAIN = 1e-6
"""Of all bounds together: what gains less is left."""
COARSE = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 25, 30, 40, 50, 65, 80)
"""Whose turn comes in a coarse visit, where what can be reached only grows; the others follow."""


@dataclass
class Turn:
    """A slot, the best field it has had, and what all bounds together gained by its last turn."""

    n: int
    slot: Slot
    field: Field | None = None
    gained: float = 0.0


class Proof:
    """Bounds (N,) of the slots' weighted sum rates, lowered in place until nothing is left to try or `stop` says so.

    rates_kbps: (K, N) of a good plan: who is served in it is where the fields begin. weights: (K, N), what each rate
    counts, default 1. told: called after each piece of work. visits: `VISITS` or fewer; after all of them it goes on
    while that gains anything. looks: how many assignments were solved.
    """

    def __init__(
        self,
        problem: Problem,
        rates_kbps: Array,
        bounds: Array,
        weights: Array | None,
        stop: Callable[[], bool],
        told: Callable[[], None] = lambda: None,
        *,
        visits: tuple[Visit, ...] = VISITS,
    ) -> None:
        self.problem, self.rates_kbps, self.bounds, self.weights = problem, rates_kbps, bounds, weights
        self.stop, self.told, self.visits = stop, told, visits
        self.ground: Ground = ground_of(problem)
        self.growing = weights is None and not np.isfinite(problem.end_m).any()
        self.looks = 0

    def run(self) -> bool:
        """Lower the bounds; whether there was time for everything."""
        if self.problem.n_users < 2:
            return True
        turns: list[Turn] = []
        for stretch in reversed(stretches_of(self.problem, self.ground)):
            if self.problem.flying[:, stretch.first].sum() > 1:
                turns += self._begin(stretch.first, stretch.end)
        for visit in self.visits:
            for turn in turns:
                if self.stop():
                    return False
                if self._is_due(turn, visit):
                    self._take(turn, turns, visit)
        return len(self.visits) < len(VISITS) or self._go_on(turns)

    def _go_on(self, turns: list[Turn]) -> bool:
        """Take the turns that gain, the one that gained most first; whether there was time until none does."""
        while turns:
            turn = max(turns, key=lambda one: one.gained)
            if turn.gained <= LEAST_GAIN * float(self.bounds.sum()):
                break
            if self.stop():
                return False
            self._take(turn, turns, AGAIN)
        return True

    def _begin(self, first: int, end: int) -> list[Turn]:
        """Return the turns of a stretch [first, end), from its last slot on, with a bound wherever the UAVs are."""
        last = end - 1
        turns = [Turn(n, self._slot(n)) for n in range(last, max(first, 1) - 1, -1) if n >= self.problem.counted_from]
        if self.weights is None and turns and not self.stop():
            slot = everywhere(self.problem, self.ground, last)
            field = first_field(self.ground, slot, self.rates_kbps[:, last])
            least, best = self._sharpened(field, slot, FREE)
            least = min(least, best.improve(slot, LAST_STEPS))
            turns[0].field = best
            self.bounds[first:end] = np.minimum(self.bounds[first:end], least)
            self.told()
        return turns

    def _is_due(self, turn: Turn, visit: Visit) -> bool:
        """Return whether another look at the slot can gain anything, and whether it is its time."""
        if self.growing and turn.slot.free:
            return False
        return not visit.coarse or not self.growing or turn.n in COARSE

    def _take(self, turn: Turn, turns: list[Turn], visit: Visit) -> None:
        """Go on from the slot's own field, or from that of the next slot that has one."""
        before, was = turn.field, float(self.bounds.sum())
        if before is None:
            later = [one for one in turns if one.n > turn.n and one.field is not None]
            before = min(later, key=lambda one: one.n).field if later else None
        if before is None:
            before = first_field(self.ground, turn.slot, self.rates_kbps[:, turn.n])
        least, turn.field = self._sharpened(before.under(before.repulsion, AGE // 2), turn.slot, visit)
        self.bounds[turn.n] = min(self.bounds[turn.n], least)
        if self.growing:
            first = next(one.first for one in stretches_of(self.problem, self.ground) if one.first <= turn.n < one.end)
            self.bounds[first : turn.n] = np.minimum(self.bounds[first : turn.n], self.bounds[turn.n])
        turn.gained = was - float(self.bounds.sum())
        self.told()

    def _sharpened(self, field: Field, slot: Slot, visit: Visit) -> tuple[float, Field]:
        self.looks += (visit.kappas + 1) * visit.steps
        return sharpened(field, slot, visit.kappas, visit.steps, stop=self.stop)

    def _slot(self, n: int) -> Slot:
        near2, far2 = squared_distance_range(self.problem, np.array([n]))
        weights = None if self.weights is None else self.weights[:, n]
        return slot_of(self.problem, self.ground, n, near2[:, :, 0], far2[:, :, 0], weights)
