"""A field made of sources at the users who are served, and the Frank-Wolfe method that makes it better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Medium, spread, worth_of_serving
from skyfolio.planner.crowding.repulsion import STEP, Repulsion
from skyfolio.planner.crowding.slots import LOG_STEP, Ground, Slot
from skyfolio.planner.fast.arena import plain

Ints: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True)
class Answer:
    """The best a fleet can do against a field. bound: weighted kbit/s that no fleet exceeds in the slot.

    users, features: (A,), who is served in the assignment that has it, and with how strong a feature. bare: what these
    columns are worth together without repulsion.
    """

    bound: float
    users: Ints
    features: Array
    bare: float


class Field:
    """Sources of weight `mass` (K,) at the users; every mass proves a bound.

    Rounding and interpolation only make the bound greater. bare, half_square: of the mix of assignments that the steps
    have gone towards, worth without repulsion and half the sum of squares of the features. age: steps taken.
    """

    def __init__(self, ground: Ground, repulsion: Repulsion, mass: Array, *, age: int = 0) -> None:
        self.ground, self.repulsion = ground, repulsion
        self.mass = np.zeros(len(mass))
        self.at_users = np.zeros(len(mass))
        self.norm2 = 0.0
        self.bare = self.half_square = 0.0
        self.age = age
        users = np.flatnonzero(mass).astype(np.int64)
        self._add(users, mass[users], 0.0)

    @property
    def medium(self) -> Medium:
        """What the kernels need to know of kappa and the levels of y, with the error of this field."""
        repulsion, ground = self.repulsion, self.ground
        return Medium(
            room=plain(repulsion.room),
            levels=ground.levels,
            logs=ground.logs,
            log_step=LOG_STEP,
            least_log=ground.least_log,
            at_zero=repulsion.at_zero,
            value_error=repulsion.value_error * float(self.mass.sum()),
        )

    def answer(self, slot: Slot) -> Answer:
        """Return the bound that this field proves for the slot."""
        shape = slot.links.snr.shape
        worth, feature, bare = np.empty(shape), np.empty(shape), np.empty(shape)
        worth_of_serving(self.medium, slot.links, self.at_users, worth, feature, bare)
        row, users = self._assigned(slot, worth)
        total = float(self.mass.sum())
        norm2 = self.norm2 + self.repulsion.value_error * total**2
        bound = 0.5 * norm2 + float(worth[row, users].sum())
        return Answer(bound, users, feature[row, users], float(bare[row, users].sum()))

    def improve(self, slot: Slot, steps: int) -> float:
        """Step towards what answers the field, `steps` times: the least bound on the way."""
        least = np.inf
        for _ in range(steps):
            answer = self.answer(slot)
            least = min(least, answer.bound)
            share = 2.0 / (self.age + 8.0)
            self._add(answer.users, answer.features * share, share)
            self.bare += share * (answer.bare - self.bare)
            self.half_square += share * (float(answer.features @ answer.features) / 2 - self.half_square)
            self.age += 1
        return least

    def renew(self) -> None:
        """Let the next steps be long ones again: the slot is another."""
        self.age = min(self.age, 16)

    def under(self, repulsion: Repulsion, age: int) -> Field:
        """Return a field of the same mass under another kappa."""
        field = Field(self.ground, repulsion, self.mass, age=age)
        field.bare, field.half_square = self.bare, self.half_square
        return field

    def _assigned(self, slot: Slot, worth: Array) -> tuple[Ints, Ints]:
        """Return rows (A,) and users (A,) of the best assignment."""
        if slot.same:
            value = worth[slot.rows[0], np.arange(worth.shape[1])]
            some = min(slot.n_uavs, len(value))
            users = np.argpartition(-value, some - 1)[:some].astype(np.int64)
            return slot.rows[0, users], users
        uav, users = linear_sum_assignment(worth[slot.rows, np.arange(worth.shape[1])], maximize=True)
        return slot.rows[uav, users], np.asarray(users, dtype=np.int64)

    def _add(self, users: Ints, weights: Array, fade: float) -> None:
        """Let what is there fade by a share, and add sources."""
        kept = 1.0 - fade
        self.at_users *= kept
        self.mass *= kept
        self.norm2 *= kept * kept
        before = self.at_users[users]
        spread(self.ground.user, users, plain(weights), STEP, plain(self.repulsion.value), self.at_users)
        self.norm2 += float(weights @ (before + self.at_users[users]))
        np.add.at(self.mass, users, weights)
