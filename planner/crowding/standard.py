"""A kappa to begin with, for fleets and areas of about the same size: one linear program after another.

Against a given field the bound is a linear program in the weights of kappa: the greatest worth over users and intervals
of x, in its dual form. It is solved for users spread evenly over a square.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linprog
from scipy.special import j0

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Links
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import frequencies, looked_at
from skyfolio.planner.crowding.repulsion import Repulsion, repulsion_of, rings_until
from skyfolio.planner.crowding.slots import Ground, Slot, logs_until, rounded_up

Ints: TypeAlias = NDArray[np.int64]
USERS, LOOKED_AT = 100, 60
"""At least how many users are in the square, and how many the program looks at: those that are worth most."""
ROUNDS, STEPS = 2, 30
LEAST_HEARD, MOST_HEARD = 2.0, 4.0
"""Only an x in this range about the typical one is looked at; in general every one of them counts."""


def far_apart(user: Array, some: int) -> Ints:
    """Return `some` users far from each other, each one the farthest from those before."""
    chosen = [int(np.argmax(((user - user.mean(axis=0)) ** 2).sum(axis=1)))]
    away2 = np.full(len(user), np.inf)
    for _ in range(min(some, len(user)) - 1):
        away2 = np.minimum(away2, ((user - user[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(away2)))
    return np.array(chosen, dtype=np.int64)


def mass_of(ground: Ground, slot: Slot, users: Ints) -> Array:
    """Return the mass (K,) of a fleet that hovers over these users."""
    links = slot.links
    gain, heard = links.power[0, users], _heard_at(ground.user[users], links.power[0, users])
    own = links.gain[0, users] / links.height2[0]
    price = links.scale[0, users] * own / (heard * (heard + own))
    mass = np.zeros(len(ground.user))
    mass[users] = np.sqrt(2.0 * price * gain)
    return mass


def standard_repulsion(ground: Ground, slot: Slot) -> Repulsion:
    """Return a kappa for fleets and areas of about this size, wherever the users are; made once for each size.

    It is fitted to users spread evenly over a square.
    """
    gain = rounded_up(max(float(np.median(slot.links.power)), 1e-12), 1.5)
    return _standard(len(slot.classes), ground.span, gain)


@lru_cache(maxsize=64)
def _standard(n_uavs: int, span: float, gain: float) -> Repulsion:
    ground, slot = _square(n_uavs, span, gain)
    mass, before = mass_of(ground, slot, far_apart(ground.user, n_uavs)), None
    tried = []
    for _ in range(ROUNDS):
        repulsion = _fitted(ground, slot, mass, before)
        before = Field(ground, repulsion, mass)
        tried.append((before.improve(slot, STEPS), repulsion))
        mass = before.mass
    return min(tried, key=lambda one: one[0])[1]


def _square(n_uavs: int, span: float, gain: float) -> tuple[Ground, Slot]:
    """Return a fleet that can be anywhere over users spread evenly."""
    side = span / 2**0.5
    count = np.arange(1, max(USERS, 2 * n_uavs) + 1)
    ratio = 1.32471795724474602596  # of a low-discrepancy sequence in the plane
    user = np.ascontiguousarray(np.stack([count / ratio % 1.0, count / ratio**2 % 1.0], axis=1) * side)
    levels, logs, least_log = logs_until(n_uavs * gain, gain)
    kinds = np.zeros(n_uavs, dtype=np.int64)
    ground = Ground(1.0, user, span, rings_until(span), levels, logs, least_log, np.full(n_uavs, gain), kinds, True)
    farthest2 = 1.0 + (np.maximum(user, side - user) ** 2).sum(axis=1)
    strong, rings = np.full((1, len(user)), gain), np.zeros((n_uavs, len(user)), dtype=np.int64)
    least = 1.0 + (n_uavs - 1) * strong / farthest2
    links = Links(strong, strong, np.ones(strong.shape), least, np.ones(1))
    return ground, Slot(links, kinds, np.repeat(least, n_uavs, axis=0), rings, np.full((n_uavs, 3), span), True)


def _fitted(ground: Ground, slot: Slot, mass: Array, before: Field | None) -> Repulsion:
    """Return the kappa that proves most against the field of `mass` (K,).

    The price of each interval of x is what it was in the field `before`; without one, the slope of log(1 + S/x).
    """
    frequency, distance = frequencies(ground.span), looked_at(ground.span)
    users = _promising(slot, mass, before)
    sources = np.flatnonzero(mass)
    pull = _felt(ground.user[users], ground.user[sources], mass[sources], frequency)  # (users, W)
    norm2 = mass[sources] @ _felt(ground.user[sources], ground.user[sources], mass[sources], frequency)
    whose, worth, feature = _priced(ground, slot, users, before, _heard(ground, slot, mass))
    n, rows = len(users), len(worth)
    per_user = sparse.csr_matrix((np.ones(rows), (np.arange(rows), whose)), shape=(rows, n))
    slope = feature[:, None] ** 2 / 2 - feature[:, None] * pull[whose]
    minorant = sparse.csr_matrix(j0(np.outer(distance, frequency)))
    found = linprog(
        np.concatenate([norm2 / 2, [len(slot.classes)], np.ones(n)]),
        A_ub=sparse.vstack(
            [
                sparse.hstack([sparse.csr_matrix(slope), -np.ones((rows, 1)), -per_user]),
                sparse.hstack([minorant, sparse.csr_matrix((len(distance), n + 1))]),
            ]
        ).tocsr(),
        b_ub=np.concatenate([-worth, 1.0 / (1.0 + distance**2)]),
        bounds=[(0, None)] * len(frequency) + [(None, None)] + [(0, None)] * n,
        method="highs",
    )
    weight = np.zeros(len(frequency))
    if found.x is not None:
        weight = np.maximum(np.asarray(found.x[: len(frequency)], dtype=float), 0.0)
    if not weight.any():
        weight[1] = 1e-6  # anything proves something
    return repulsion_of(frequency, weight, ground.span, ground.rings)


def _priced(ground: Ground, slot: Slot, users: Ints, before: Field | None, heard: float) -> tuple[Ints, Array, Array]:
    """Of each user's intervals of x: whose, worth without repulsion, and feature."""
    gain = slot.links.gain[0, users][:, None]
    low, high = ground.levels[:-1][None], ground.levels[1:][None]
    at_low, at_high = np.log1p(gain / low), np.log1p(gain / high)
    if before is None:
        price = (at_low - at_high) / (high - low)
    else:
        felt = np.maximum(before.at_users[0, users], 0.0)[:, None]
        price = 0.5 * gain * (felt / (high - 1.0 + gain * before.repulsion.at_zero)) ** 2
    worth = np.maximum(at_low + price * low, at_high + price * high) - price
    feature = np.sqrt(2.0 * price * gain)
    kept = (high > np.maximum(slot.links.least[0, users][:, None], heard / LEAST_HEARD)) & (low < MOST_HEARD * heard)
    kept[:, 1::2] = False
    return np.nonzero(kept)[0], worth[kept], feature[kept]


def _heard(ground: Ground, slot: Slot, mass: Array) -> float:
    """Return what is heard by a typical one of the users with the greatest masses."""
    some = min(len(slot.classes), int((mass > 0.0).sum()))
    users = np.argpartition(-mass, some - 1)[:some]
    return float(np.median(_heard_at(ground.user[users], slot.links.power[0, users])))


def _heard_at(at: Array, power: Array) -> Array:
    """Noise and interference at each place when a UAV hovers over each of them: (P,)."""
    apart2 = ((at[:, None] - at[None]) ** 2).sum(axis=2)
    heard: Array = 1.0 + (power * (1.0 / (1.0 + apart2) - np.eye(len(at)))).sum(axis=1)
    return heard


def _felt(points: Array, sources: Array, weights: Array, frequency: Array) -> Array:
    """Return what the sources add up to at each point, by frequency: (P, W)."""
    apart = np.linalg.norm(points[:, None] - sources[None], axis=2)
    return np.stack([j0(apart * one) @ weights for one in frequency], axis=1)


def _promising(slot: Slot, mass: Array, before: Field | None) -> Ints:
    """Return the users that are worth most in the field, or the sources and some others."""
    count = len(mass)
    if before is None:
        return np.union1d(np.linspace(0, count - 1, LOOKED_AT).astype(np.int64), np.flatnonzero(mass))
    return np.argpartition(-before.worth_of_users(slot), LOOKED_AT)[:LOOKED_AT]
