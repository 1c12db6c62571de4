"""Kappas to begin with, for fleets and areas of about the same size: fitted once to users that are as crowded.

They stand evenly over a rectangle whose diagonal is the span: the narrower it is, the more a fleet above it is heard by
itself. Which one is like the users at hand shows in the interference of UAVs that hover as far apart as they can.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Links
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.fit import bell, sharpened
from skyfolio.planner.crowding.repulsion import Repulsion, repulsion_of
from skyfolio.planner.crowding.slots import Ground, Slot, logs_until, rounded_up

Ints: TypeAlias = NDArray[np.int64]
USERS = 100
"""At least how many users are in the rectangle."""
ASPECTS = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Short by long side."""
FLEET_RATIO, GAIN_RATIO = 1.2, 1.5
"""Of neighbouring sizes of fleets, and gains, that have kappas of their own."""
BELLS = (3.0, 8.0, 20.0, 50.0)
"""Squares of the widths that are tried first."""
KAPPAS, STEPS = 20, 40


def far_apart(user: Array, some: int) -> Ints:
    """Return `some` users far from each other, each one the farthest from those before."""
    chosen = [int(np.argmax(((user - user.mean(axis=0)) ** 2).sum(axis=1)))]
    away2 = np.full(len(user), np.inf)
    for _ in range(min(some, len(user)) - 1):
        away2 = np.minimum(away2, ((user - user[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(away2)))
    return np.array(chosen, dtype=np.int64)


def mass_of(ground: Ground, gain: float, scale: Array, users: Ints) -> Array:
    """Return the mass (K,) of a fleet that hovers over these users. scale: (A,), kbit/s per nat of each of them."""
    heard = heard_at(ground.user[users], gain)
    price = scale * gain / (heard * (heard + gain))
    mass = np.zeros(len(ground.user))
    mass[users] = np.sqrt(2.0 * price * gain)
    return mass


def heard_at(at: Array, gain: float) -> Array:
    """Noise and interference at each place when a UAV hovers over each of them: (P,)."""
    apart2 = ((at[:, None] - at[None]) ** 2).sum(axis=2)
    heard: Array = 1.0 + gain * ((1.0 / (1.0 + apart2)).sum(axis=1) - 1.0)
    return heard


def standard_repulsion(ground: Ground, gain: float, apart: Ints) -> Repulsion:
    """Return a kappa for fleets and users about like these; made once for each size. apart: (U,), see `far_apart`."""
    fleet = max(2, round(rounded_up(len(apart), FLEET_RATIO)))
    rounded = rounded_up(max(gain, 1e-12), GAIN_RATIO)
    heard = float(heard_at(ground.user[apart], gain).mean()) - 1.0
    others = [float(_heard_over(len(apart), ground.span, gain, aspect)) for aspect in ASPECTS]
    like = int(np.argmin(np.abs(np.log(np.maximum(others, 1e-12) / max(heard, 1e-12)))))
    return _standard(fleet, ground.span, rounded, ASPECTS[like])


@lru_cache(maxsize=1024)
def _heard_over(n_uavs: int, span: float, gain: float, aspect: float) -> float:
    user = _evenly(n_uavs, span, aspect)
    return float(heard_at(user[far_apart(user, n_uavs)], gain).mean()) - 1.0


@lru_cache(maxsize=64)
def _standard(n_uavs: int, span: float, gain: float, aspect: float) -> Repulsion:
    ground, slot = _rectangle(n_uavs, span, gain, aspect)
    apart = far_apart(ground.user, n_uavs)
    mass = mass_of(ground, gain, np.ones(n_uavs), apart)
    fields = [Field(ground, repulsion_of(bell(width2, span), span), mass) for width2 in BELLS]
    best = min(fields, key=lambda one: one.improve(slot, STEPS))
    return sharpened(best, slot, KAPPAS, STEPS)[1].repulsion


def _evenly(n_uavs: int, span: float, aspect: float) -> Array:
    """Return users (K, 2) spread evenly over a rectangle."""
    side = span / np.hypot(1.0, aspect) * np.array([1.0, aspect])
    count = np.arange(1, max(USERS, 2 * n_uavs) + 1)
    ratio = 1.32471795724474602596  # of a low-discrepancy sequence in the plane
    return np.ascontiguousarray(np.stack([count / ratio % 1.0, count / ratio**2 % 1.0], axis=1) * side)


def _rectangle(n_uavs: int, span: float, gain: float, aspect: float) -> tuple[Ground, Slot]:
    """Return a fleet that can be anywhere over users spread evenly."""
    user = _evenly(n_uavs, span, aspect)
    levels, logs, least_log = logs_until(n_uavs * gain, gain)
    kinds = np.zeros(n_uavs, dtype=np.int64)
    ground = Ground(1.0, user, span, levels, logs, least_log, np.full(n_uavs, gain), kinds, True)
    strong, none = np.full((1, len(user)), gain), np.zeros((1, len(user)), dtype=np.int64)
    links = Links(strong, strong, np.ones(strong.shape), 1.0 + (n_uavs - 1) * strong / (1.0 + span**2), none)
    return ground, Slot(links, np.zeros((n_uavs, len(user)), dtype=np.int64), same=True, free=True)
