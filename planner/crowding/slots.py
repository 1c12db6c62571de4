"""The arrays of one slot as the crowding bound takes them: who can be where, and how strong each UAV is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Links
from skyfolio.planner.crowding.repulsion import RINGS
from skyfolio.planner.fast.arena import plain
from skyfolio.planner.problem import Problem

Ints: TypeAlias = NDArray[np.int64]
LEVEL = 1.07
"""Ratio of neighbouring values of y = noise + interference."""
BEYOND = 20.0
"""How far the values of y go beyond what can be heard: they grow with a UAV's distance from its user."""
SPAN_RATIO = 1.1
"""Of neighbouring spans: areas of about the same size share their tables."""
LEAST_SPAN = 1.0
"""Of users in one place."""
LOG_STEP, LOGS_BELOW = 0.1, 14.0
"""Grid of log S, and how far below the greatest S it begins."""


@dataclass(frozen=True)
class Ground:
    """What is the same in every slot. Lengths are in units of `unit_m`, the greatest altitude, gains of its square.

    user: (K, 2). span: no two users are farther apart, rounded up. levels: (L,), values of y. logs: (Y, L),
    log(1 + e^s / y) from s = least_log on. power: (U,), transmit power as a mean gain. classes: (U,), which UAVs differ
    in nothing but where they can be (each has its own class when fading is sampled). alike: whether gains are the same
    in all slots in which a UAV flies.
    """

    unit_m: float
    user: Array
    span: float
    levels: Array
    logs: Array
    least_log: float
    power: Array
    classes: Ints
    alike: bool


@dataclass(frozen=True)
class Slot:
    """One slot of U flying UAVs and K users.

    links: by row. rows: (U, K), which row holds a UAV's link. same: whether all UAVs are the same in everything. free:
    whether they can be anywhere, too.
    """

    links: Links
    rows: Ints
    same: bool
    free: bool

    @property
    def n_uavs(self) -> int:
        """How many fly."""
        return len(self.rows)


def ground_of(problem: Problem) -> Ground:
    """Return what all slots have in common."""
    unit = float(problem.altitude_m.max())
    user = plain(problem.mean_user_m / unit)
    across = float(np.linalg.norm(user.max(axis=0) - user.min(axis=0)))
    alike = problem.snr_gain.strides[1] == 0
    gains = problem.snr_gain[:, :1] if alike else problem.snr_gain
    strongest = gains.max(axis=2)  # (U, 1 or K), over the slots in which it flies
    nearest = strongest / problem.altitude_m[:, None] ** 2
    most = float(nearest.sum(axis=0).max())
    levels, logs, least_log = logs_until(most, float(nearest.max()))
    power = np.maximum(strongest.mean(axis=1), 1e-300) / unit**2
    kinds = np.stack([problem.bandwidth_hz, problem.altitude_m, power], axis=1)
    classes = np.unique(kinds, axis=0, return_inverse=True)[1].reshape(-1) if alike else np.arange(problem.n_uavs)
    return Ground(
        unit_m=unit,
        user=user,
        span=rounded_up(max(across, LEAST_SPAN), SPAN_RATIO),
        levels=levels,
        logs=logs,
        least_log=least_log,
        power=power,
        classes=np.asarray(classes, dtype=np.int64),
        alike=alike,
    )


def rounded_up(value: float, ratio: float) -> float:
    """Return the least power of `ratio` that is not less."""
    return float(ratio ** np.ceil(np.log(value) / np.log(ratio) - 1e-9)) * (1.0 + 1e-8)


def logs_until(most_heard: float, most_snr: float) -> tuple[Array, Array, float]:
    """Return values (L,) of y from 1 on, log(1 + e^s / y) (Y, L) up to most_snr, and the least s."""
    last = np.log1p(most_heard * BEYOND)
    levels = np.asarray(LEVEL ** np.arange(int(np.ceil(last / np.log(LEVEL))) + 2), dtype=float)
    least_log = float(np.log(max(most_snr, 1e-12))) - LOGS_BELOW
    grid = least_log + LOG_STEP * np.arange(int(LOGS_BELOW / LOG_STEP) + 3)
    return levels, np.log1p(np.exp(grid)[:, None] / levels), least_log


def slot_of(problem: Problem, ground: Ground, n: int, near2: Array, far2: Array, weights: Array | None = None) -> Slot:
    """Return the arrays of slot n.

    near2, far2: (U, K), m^2, of `planner.reach`. weights: (K,) of the users' rates, default 1.
    """
    flying = np.flatnonzero(problem.flying[:, n])
    weak = problem.snr_gain[flying, :, n] / far2[flying]
    heard = 1.0 + np.maximum(weak.sum(axis=0) - weak, 0.0) * (1.0 - 1e-9)
    away_m = np.sqrt(np.maximum(near2[flying] - problem.altitude_m[flying, None] ** 2, 0.0))
    return _slot(problem, ground, n, _rings(away_m / ground.unit_m), heard, weights)


def everywhere(problem: Problem, ground: Ground, n: int, weights: Array | None = None) -> Slot:
    """Return slot n as if every UAV could be anywhere in the area: greater, and cheaper to bound for one class.

    weights: (K,) of the users' rates, default 1.
    """
    flying = np.flatnonzero(problem.flying[:, n])
    corner2 = (np.maximum(problem.mean_user_m - problem.low_m, problem.high_m - problem.mean_user_m) ** 2).sum(axis=1)
    weak = problem.snr_gain[flying, :, n] / (corner2 + problem.altitude_m[flying, None] ** 2)
    heard = 1.0 + np.maximum(weak.sum(axis=0) - weak.max(axis=0), 0.0) * (1.0 - 1e-9)
    inside = np.clip(problem.mean_user_m, problem.low_m, problem.high_m)
    ring = _rings(np.linalg.norm(problem.mean_user_m - inside, axis=1) / ground.unit_m)
    shape = weak.shape
    return _slot(problem, ground, n, np.broadcast_to(ring, shape), np.broadcast_to(heard, shape), weights)


def _slot(problem: Problem, ground: Ground, n: int, ring: Ints, heard: Array, weights: Array | None) -> Slot:
    """Return the slot in which each flying UAV is in this ring (U, K) of a user or beyond; `heard` (U, K) by it."""
    flying = np.flatnonzero(problem.flying[:, n])
    kinds, first, classes = np.unique(ground.classes[flying], return_index=True, return_inverse=True)
    code = classes.reshape(-1, 1) * len(RINGS) + ring
    there = np.zeros(len(kinds) * len(RINGS), dtype=bool)
    there[code] = True
    rows = (np.cumsum(there) - 1)[code]
    kind, edge = np.divmod(np.flatnonzero(there), len(RINGS))
    n_users = len(ground.user)
    least = np.full((len(kind), n_users), np.inf)
    for row, mine in zip(rows, heard, strict=True):
        here = row, np.arange(n_users)
        least[here] = np.minimum(least[here], mine)
    gain = problem.snr_gain[flying, :, n] / ground.unit_m**2
    faintest = (gain / ground.power[flying, None]).min(axis=0)  # of the users' channels, for unit power
    one = flying[first[kind]]
    height2 = (problem.altitude_m[one] / ground.unit_m) ** 2
    scale = problem.bandwidth_hz[one] / (1e3 * np.log(2))
    links = Links(
        snr=plain(np.where(np.isfinite(least), gain[first[kind]] / (height2 + RINGS[edge] ** 2)[:, None], 0.0)),
        power=plain(ground.power[one, None] * faintest),
        scale=plain(scale[:, None] * (np.ones(n_users) if weights is None else weights)),
        least=plain(least),
        ring=plain(np.repeat(edge[:, None], n_users, axis=1), np.int64),
    )
    rows = plain(rows, np.int64)
    return Slot(links=links, rows=rows, same=bool((rows == rows[0]).all()), free=len(kinds) == 1 and not ring.any())


def _rings(away: Array) -> Ints:
    """Return the ring in which a distance lies, or the one before where rounding could tell."""
    found = np.searchsorted(RINGS, away * (1.0 - 1e-9), side="right") - 1
    return np.asarray(np.maximum(found, 0), dtype=np.int64)
