"""A field made of sources at the users who are served, and the Frank-Wolfe method that makes it better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Medium, spread, worth_of_reaching, worth_of_serving
from skyfolio.planner.crowding.repulsion import STEP, Repulsion
from skyfolio.planner.crowding.slots import LOG_STEP, Ground, Slot
from skyfolio.planner.fast.arena import plain

Ints: TypeAlias = NDArray[np.int64]


CANDIDATES = 16
"""Users of each UAV for whom it is looked at closely where it can be."""


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
        self.tables = plain(np.stack([repulsion.value, repulsion.slope, repulsion.bend]))
        self.mass = np.zeros(len(mass))
        self.at_users = np.zeros((4 + len(repulsion.low), len(mass)))
        self.norm2 = 0.0
        self.bare = self.half_square = 0.0
        self.age = age
        users = np.flatnonzero(mass).astype(np.int64)
        self._add(users, mass[users], 0.0)

    @property
    def medium(self) -> Medium:
        """What the kernels need to know of kappa and the levels of x, with the errors of this field."""
        total, repulsion, ground = float(self.mass.sum()), self.repulsion, self.ground
        return Medium(
            step=STEP,
            tables=self.tables,
            low=plain(repulsion.low),
            rings=ground.rings,
            share=repulsion.share,
            levels=ground.levels,
            logs=ground.logs,
            log_step=LOG_STEP,
            least_log=ground.least_log,
            at_zero=repulsion.at_zero,
            value_error=repulsion.value_error * total,
            slope_error=repulsion.slope_error * total,
        )

    def answer(self, slot: Slot, *, close: bool = False) -> Answer:
        """Return the bound that this field proves for the slot; close: looking closely at where each UAV can be."""
        if slot.free:
            value, feature, bare = (table[0, :, 0] for table in self._worth(slot))
            some = min(len(slot.classes), len(value))
            users = np.argpartition(-value, some - 1)[:some].astype(np.int64)
            won, features, alone = value[users], feature[users], bare[users]
        else:
            value, feature, bare = self._reached(slot)
            if close:
                self._look_closely(slot, value, feature, bare)
            uav, users = linear_sum_assignment(value, maximize=True)
            won, features, alone = value[uav, users], feature[uav, users], bare[uav, users]
        total = float(self.mass.sum())
        norm2 = self.norm2 + self.repulsion.value_error * total**2
        bound = 0.5 * norm2 + float(won.sum())
        return Answer(bound, np.asarray(users, dtype=np.int64), features, float(alone.sum()))

    def improve(self, slot: Slot, steps: int, *, close: bool = False) -> float:
        """Step towards what answers the field, `steps` times: the least bound on the way."""
        least = np.inf
        for _ in range(steps):
            answer = self.answer(slot, close=close)
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

    def worth_of_users(self, slot: Slot) -> Array:
        """Return what each user is worth to the nearest UAV: (K,)."""
        worth: Array = self._worth(slot)[0][:, :, 0].max(axis=0)
        return worth

    def _reached(self, slot: Slot) -> tuple[Array, Array, Array]:
        """Return what a UAV is worth to a user from the nearest ring that it reaches: (U, K), features, and bare."""
        at = slot.classes[:, None], np.arange(len(self.mass)), slot.ring
        worth, feature, bare = (plain(table[at]) for table in self._worth(slot))
        return worth, feature, bare

    def _look_closely(self, slot: Slot, worth: Array, feature: Array, bare: Array) -> None:
        """Lower the (U, K) tables in place for the most promising pairs."""
        some = min(CANDIDATES, worth.shape[1])
        candidates = plain(np.argpartition(-worth, some - 1, axis=1)[:, :some], np.int64)
        sources = np.flatnonzero(self.mass).astype(np.int64)
        worth_of_reaching(
            self.medium,
            slot.links,
            slot.classes,
            slot.least,
            self.ground.user,
            slot.disc,
            self.at_users,
            sources,
            self.mass[sources],
            candidates,
            worth,
            feature,
            bare,
        )

    def _worth(self, slot: Slot) -> tuple[Array, Array, Array]:
        shape = (*slot.links.gain.shape, len(self.repulsion.share))
        worth, feature, bare = np.empty(shape), np.empty(shape), np.empty(shape)
        worth_of_serving(self.medium, slot.links, self.at_users, slot.free, worth, feature, bare)
        return worth, feature, bare

    def _add(self, users: Ints, weights: Array, fade: float) -> None:
        """Let what is there fade by a share, and add sources."""
        kept = 1.0 - fade
        self.at_users *= kept
        self.mass *= kept
        self.norm2 *= kept * kept
        before = self.at_users[0, users]
        spread(self.ground.user, users, weights, self.ground.user, STEP, self.tables, self.repulsion.low, self.at_users)
        self.norm2 += float(weights @ (before + self.at_users[0, users]))
        np.add.at(self.mass, users, weights)
