"""A field made of sources at the users who are served, and the Frank-Wolfe method that makes it better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import spread, worth_of_serving
from skyfolio.planner.crowding.repulsion import STEP, Repulsion
from skyfolio.planner.crowding.slots import LOG_STEP, Ground, Slot

Ints: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True)
class Answer:
    """The best a fleet can do against a field. bound: weighted kbit/s that no fleet exceeds in the slot.

    users, features: (A,), who is served in the assignment that has it, and with how strong a feature.
    """

    bound: float
    users: Ints
    features: Array


class Field:
    """Sources of weight `mass` (K,) at the users; every mass proves a bound.

    Rounding and interpolation only make the bound greater.
    """

    def __init__(self, ground: Ground, repulsion: Repulsion, mass: Array) -> None:
        self.ground, self.repulsion = ground, repulsion
        self.tables = np.ascontiguousarray(np.stack([repulsion.value, repulsion.slope, repulsion.bend]))
        self.mass = np.zeros(len(mass))
        self.at_users = np.zeros((4 + len(repulsion.low), len(mass)))
        self.norm2 = 0.0
        self.age = 0
        users = np.flatnonzero(mass)
        self._add(users, mass[users], 0.0)

    def answer(self, slot: Slot) -> Answer:
        """Return the bound that this field proves for the slot."""
        worth, feature = self._worth(slot)
        if slot.free:
            value = worth[0, :, 0]
            some = min(len(slot.classes), len(value))
            users = np.argpartition(-value, some - 1)[:some]
            won, features = value[users], feature[0, users, 0]
        else:
            everyone = np.arange(worth.shape[1])
            value = worth[slot.classes[:, None], everyone, slot.ring]
            uav, users = linear_sum_assignment(value, maximize=True)
            won, features = value[uav, users], feature[slot.classes[uav], users, slot.ring[uav, users]]
        total = float(self.mass.sum())
        norm2 = self.norm2 + self.repulsion.value_error * total**2
        return Answer(0.5 * norm2 + float(won.sum()), np.asarray(users, dtype=np.int64), features)

    def improve(self, slot: Slot, steps: int) -> float:
        """Step towards what answers the field, `steps` times: the least bound on the way."""
        least = np.inf
        for _ in range(steps):
            answer = self.answer(slot)
            least = min(least, answer.bound)
            share = 2.0 / (self.age + 8.0)
            self._add(answer.users, answer.features * share, share)
            self.age += 1
        return least

    def worth_of_users(self, slot: Slot) -> Array:
        """Return what each user can be worth to the nearest UAV: (K,)."""
        worth: Array = self._worth(slot)[0][:, :, 0].max(axis=0)
        return worth

    def renew(self) -> None:
        """Let the next steps be long ones again: the slot is another."""
        self.age = min(self.age, 16)

    def _worth(self, slot: Slot) -> tuple[Array, Array]:
        shape = (*slot.gain.shape, len(self.repulsion.share))
        worth, feature = np.empty(shape), np.empty(shape)
        total = float(self.mass.sum())
        worth_of_serving(
            self.at_users,
            self.repulsion.value_error * total,
            self.repulsion.slope_error * total,
            self.repulsion.at_zero,
            self.ground.rings,
            self.repulsion.share,
            slot.gain,
            slot.height2,
            slot.power,
            slot.scale,
            slot.least,
            self.ground.levels,
            self.ground.logs,
            LOG_STEP,
            self.ground.least_log,
            slot.free,
            worth,
            feature,
        )
        return worth, feature

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
