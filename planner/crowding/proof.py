"""The crowding bound made tight, offline, for any fleet: kappas for every slot, and steps until they settle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.bound import first_field, stretches_of
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import AGE, sharpened
from skyfolio.planner.crowding.slots import Ground, Slot, everywhere, ground_of, slot_of
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range

FREE_STEPS, FREE_ROUNDS, LAST_STEPS = 40, 24, 120
"""For a fleet that can be anywhere: steps of the field under each kappa, how many kappas, and steps under the best."""
STEPS = 10
ROUNDS = (0, 0, 6, 12)
"""For each slot in turn: how many kappas more, the first time, the second time, and so on."""
COARSE = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 25, 30, 40, 50, 65, 80)
"""Whose turn comes the first time, where what can be reached only grows; the others follow."""


@dataclass
class Turn:
    """A slot and the best field it has had."""

    n: int
    slot: Slot
    field: Field | None = None


class Proof:
    """Bounds (N,) of the slots' weighted sum rates, lowered in place until nothing is left to try or `stop` says so.

    rates_kbps: (K, N) of a good plan: who is served in it is where the fields begin. weights: (K, N), what each rate
    counts, default 1. told: called after each piece of work. rounds: `ROUNDS` or fewer. looks: how many assignments
    were solved.
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
        rounds: tuple[int, ...] = ROUNDS,
    ) -> None:
        self.problem, self.rates_kbps, self.bounds, self.weights = problem, rates_kbps, bounds, weights
        self.stop, self.told, self.rounds = stop, told, rounds
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
        for visit, rounds in enumerate(self.rounds):
            for turn in turns:
                if self.stop():
                    return False
                if self._is_due(turn, visit):
                    self._take(turn, turns, rounds)
        return True

    def _begin(self, first: int, end: int) -> list[Turn]:
        """Return the turns of a stretch [first, end), from its last slot on, with a bound wherever the UAVs are."""
        last = end - 1
        turns = [Turn(n, self._slot(n)) for n in range(last, max(first, 1) - 1, -1) if n >= self.problem.counted_from]
        if self.weights is None and turns and not self.stop():
            slot = everywhere(self.problem, self.ground, turns[0].slot, last)
            field = first_field(self.problem, self.ground, slot, self.rates_kbps[:, last])
            least, best = self._sharpened(field, slot, FREE_ROUNDS, FREE_STEPS)
            least = min(least, best.improve(slot, LAST_STEPS))
            turns[0].field = best
            self.bounds[first:end] = np.minimum(self.bounds[first:end], least)
            self.told()
        return turns

    def _is_due(self, turn: Turn, visit: int) -> bool:
        """Return whether another look at the slot can gain anything, and whether it is its time."""
        if self.growing and turn.slot.free:
            return False
        return visit > 0 or not self.growing or turn.n in COARSE

    def _take(self, turn: Turn, turns: list[Turn], rounds: int) -> None:
        """Go on from the slot's own field, or from that of the next slot that has one."""
        before = turn.field
        if before is None:
            later = [one for one in turns if one.n > turn.n and one.field is not None]
            before = min(later, key=lambda one: one.n).field if later else None
        if before is None:
            before = first_field(self.problem, self.ground, turn.slot, self.rates_kbps[:, turn.n])
        least, turn.field = self._sharpened(before.under(before.repulsion, AGE // 2), turn.slot, rounds, STEPS)
        self.bounds[turn.n] = min(self.bounds[turn.n], least)
        if self.growing:
            first = next(one.first for one in stretches_of(self.problem, self.ground) if one.first <= turn.n < one.end)
            self.bounds[first : turn.n] = np.minimum(self.bounds[first : turn.n], self.bounds[turn.n])
        self.told()

    def _sharpened(self, field: Field, slot: Slot, rounds: int, steps: int) -> tuple[float, Field]:
        self.looks += (rounds + 1) * steps
        return sharpened(field, slot, rounds, steps, close=True, stop=self.stop)

    def _slot(self, n: int) -> Slot:
        near2, far2 = squared_distance_range(self.problem, np.array([n]))
        weights = None if self.weights is None else self.weights[:, n]
        return slot_of(self.problem, self.ground, n, near2[:, :, 0], far2[:, :, 0], weights)
