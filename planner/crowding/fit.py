"""Which kappa proves most: a linear program over mixtures of Bessel functions."""

from __future__ import annotations

from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linprog
from scipy.special import j0

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.repulsion import Repulsion, repulsion_of, rings_until
from skyfolio.planner.crowding.slots import Ground, Slot, logs_until, rounded_up

Ints: TypeAlias = NDArray[np.int64]
LEAST_HEARD, MOST_HEARD = 2.0, 4.0
"""Only prices of an x in this range about the typical one are looked at."""
FREQUENCIES = 20
SPACING = 0.8
"""Of the frequencies, so that pi / SPACING spans are the period of the slowest."""


SAMPLE = 60
"""How many users the program looks at: those that are worth most."""
ROUNDS, STEPS = 2, 30
"""For the standard kappa: how often it is fitted, and steps of the field between."""


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
    gain, heard = slot.power[0, users], _heard_at(ground, slot, users)
    own = slot.gain[0, users] / slot.height2[0]
    price = slot.scale[0, users] * own / (heard * (heard + own))
    mass = np.zeros(len(ground.user))
    mass[users] = np.sqrt(2.0 * price * gain)
    return mass


def standard_repulsion(ground: Ground, slot: Slot) -> Repulsion:
    """Return a kappa for fleets and areas of about this size, wherever the users are; made once for each size.

    It is fitted to users spread evenly over a square.
    """
    gain = rounded_up(float(np.median(slot.power)), 1.5)
    return _standard(len(slot.classes), ground.span, gain)


@lru_cache(maxsize=64)
def _standard(n_uavs: int, span: float, gain: float) -> Repulsion:
    side = span / 2**0.5
    count = np.arange(1, max(100, 2 * n_uavs) + 1)
    ratio = 1.32471795724474602596  # of a low-discrepancy sequence in the plane
    user = np.ascontiguousarray(np.stack([count / ratio % 1.0, count / ratio**2 % 1.0], axis=1) * side)
    levels, logs, least_log = logs_until(n_uavs * gain, gain)
    kinds = np.zeros(n_uavs, dtype=np.int64)
    ground = Ground(1.0, user, span, rings_until(span), levels, logs, least_log, np.full(n_uavs, gain), kinds, True)
    farthest2 = 1.0 + (np.maximum(user, side - user) ** 2).sum(axis=1)
    strong, rings = np.full((1, len(user)), gain), np.zeros((n_uavs, len(user)), dtype=np.int64)
    least = 1.0 + (n_uavs - 1) * strong / farthest2
    slot = Slot(strong, strong, np.ones(strong.shape), least, np.ones(1), kinds, rings, True)
    mass, field = mass_of(ground, slot, far_apart(user, n_uavs)), None
    tried = []
    for _ in range(ROUNDS):
        repulsion = fitted(ground, slot, mass, field, SAMPLE)
        field = Field(ground, repulsion, mass)
        tried.append((field.improve(slot, STEPS), repulsion))
        mass = field.mass
    return min(tried, key=lambda one: one[0])[1]


def _heard_at(ground: Ground, slot: Slot, users: Ints) -> Array:
    """Noise and interference at the users when a UAV hovers over each of them: (len(users),)."""
    at = ground.user[users]
    apart2 = ((at[:, None] - at[None]) ** 2).sum(axis=2)
    heard: Array = 1.0 + (slot.power[0, users] * (1.0 / (1.0 + apart2) - np.eye(len(users)))).sum(axis=1)
    return heard


def _heard(ground: Ground, slot: Slot, mass: Array) -> float:
    """What is heard by a typical one of the users with the greatest masses."""
    some = min(len(slot.classes), int((mass > 0.0).sum()))
    return float(np.median(_heard_at(ground, slot, np.argpartition(-mass, some - 1)[:some])))


def fitted(ground: Ground, slot: Slot, mass: Array, before: Field | None, sample: int = SAMPLE) -> Repulsion:
    """Return the kappa that proves most against the field of `mass` (K,), over at most `sample` users.

    The price b of each interval of x is what it was in the field `before`; without one, the slope of log(1 + S/x).
    """
    frequency = np.arange(FREQUENCIES) * np.pi / (SPACING * ground.span)
    sources = np.flatnonzero(mass)
    users = _promising(ground, slot, mass, before, sample)
    weights = mass[sources]
    pull = _waves(ground, users, sources, frequency) @ weights  # (users, W)
    norm2 = weights @ (_waves(ground, sources, sources, frequency) @ weights)
    worth, half_square, feature, whose = _columns(ground, slot, users, before, _heard(ground, slot, mass))
    slope = half_square[:, None] - feature[:, None] * pull[whose]
    n, rows = len(users), len(worth)
    per_user = sparse.csr_matrix((np.ones(rows), (np.arange(rows), whose)), shape=(rows, n))
    distance = np.concatenate([np.arange(0, min(8.0, ground.span), 0.1), np.arange(8.0, ground.span + 0.3, 0.3)])
    below = sparse.hstack(
        [sparse.csr_matrix(j0(np.outer(distance, frequency))), sparse.csr_matrix((len(distance), n + 1))]
    )
    above = sparse.hstack([sparse.csr_matrix(slope), -np.ones((rows, 1)), -per_user])
    found = linprog(
        np.concatenate([norm2 / 2, [len(slot.classes)], np.ones(n)]),
        A_ub=sparse.vstack([above, below]).tocsr(),
        b_ub=np.concatenate([-worth, 1.0 / (1.0 + distance**2)]),
        bounds=[(0, None)] * FREQUENCIES + [(None, None)] + [(0, None)] * n,
        method="highs",
    )
    weight = found.x[:FREQUENCIES] if found.x is not None else np.zeros(FREQUENCIES)
    if not weight.any():
        weight[1] = 1e-6  # anything proves something
    return repulsion_of(frequency, weight, ground.span, ground.rings)


def _columns(
    ground: Ground, slot: Slot, users: Ints, before: Field | None, heard: float
) -> tuple[Array, Array, Array, Ints]:
    """Worth without repulsion, half the square of the feature, feature, and whose: of each user's intervals of x."""
    kind = np.argmax(slot.gain[:, users] * slot.scale[:, users], axis=0)
    gain, power, scale = (table[kind, users][:, None] for table in (slot.gain, slot.power, slot.scale))
    low, high = ground.levels[:-1][None], ground.levels[1:][None]
    own = gain / slot.height2[kind][:, None]
    at_low, at_high = scale * np.log1p(own / low), scale * np.log1p(own / high)
    if before is None:
        price = (at_low - at_high) / (high - low)
    else:
        felt = np.maximum(before.at_users[0, users], 0.0)[:, None]
        price = 0.5 * power * (felt / (high - 1.0 + power * before.repulsion.at_zero)) ** 2
    worth = np.maximum(at_low + price * low, at_high + price * high) - price
    feature = np.sqrt(2.0 * price * power)
    kept = (high > np.maximum(slot.least[kind, users][:, None], heard / LEAST_HEARD)) & (low < MOST_HEARD * heard)
    kept[:, 1::2] = False
    whose = np.nonzero(kept)[0]
    return worth[kept], feature[kept] ** 2 / 2, feature[kept], whose


def _waves(ground: Ground, users: Ints, others: Ints, frequency: Array) -> Array:
    """J0 between users: (users, W, others)."""
    apart = np.linalg.norm(ground.user[users][:, None] - ground.user[others][None], axis=2)
    waves: Array = j0(apart[:, None, :] * frequency[None, :, None])
    return waves


def _promising(ground: Ground, slot: Slot, mass: Array, before: Field | None, sample: int) -> Ints:
    """The users that are worth most in the field, or the sources and some others."""
    count = len(ground.user)
    if count <= sample:
        return np.arange(count)
    if before is None:
        some = np.linspace(0, count - 1, sample).astype(np.int64)
        return np.union1d(some, np.flatnonzero(mass))
    return np.argpartition(-before.worth_of_users(slot), sample)[:sample]
