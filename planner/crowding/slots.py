"""The arrays of one slot as the crowding bound takes them: who can be where, and how strong each UAV is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.columns import Links
from skyfolio.planner.crowding.repulsion import rings_until
from skyfolio.planner.fast.arena import plain
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import reach_of

Ints: TypeAlias = NDArray[np.int64]
LEVEL = 1.07
"""Ratio of neighbouring values of x = noise + interference."""
SPAN_RATIO = 1.1
"""Of neighbouring spans: areas of about the same size share their tables."""
LOG_STEP, LOGS_BELOW = 0.1, 14.0
"""Grid of log S, and how far below the greatest S it begins."""


@dataclass(frozen=True)
class Ground:
    """What is the same in every slot. Lengths are in units of `unit_m`, the greatest altitude, gains of its square.

    user: (K, 2). span: no two points that are users or in the area are farther apart, rounded up. rings: (R + 1,),
    edges of distance to the user. levels: (L,), values of x. logs: (Y, L), log(1 + e^y / x) from y = least_log on.
    power: (U,), transmit power as a mean gain. classes: (U,), which UAVs differ in nothing but where they can be (each
    has its own class when fading is sampled). alike: whether gains are the same in all slots in which a UAV flies.
    """

    unit_m: float
    user: Array
    span: float
    rings: Array
    levels: Array
    logs: Array
    least_log: float
    power: Array
    classes: Ints
    alike: bool


@dataclass(frozen=True)
class Slot:
    """One slot of C classes and U flying UAVs.

    links: by class. classes: (U,). least: (U, K), the least x of each. ring: (U, K), the nearest ring that the UAV can
    come to by then. disc: (U, 3), east, north and radius of where it can be. free: whether it is ring 0 for all, and
    all are of one class.
    """

    links: Links
    classes: Ints
    least: Array
    ring: Ints
    disc: Array
    free: bool


def ground_of(problem: Problem) -> Ground:
    """Return what all slots have in common."""
    unit = float(problem.altitude_m.max())
    user = plain(problem.mean_user_m / unit)
    low = np.minimum(user.min(axis=0), problem.low_m / unit)
    high = np.maximum(user.max(axis=0), problem.high_m / unit)
    span = rounded_up(float(np.linalg.norm(high - low)), SPAN_RATIO)
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
        span=span,
        rings=rings_until(span),
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
    """Return values (L,) of x from 1 to 1 + most_heard, log(1 + e^y / x) (Y, L) up to most_snr, and the least y."""
    levels = np.asarray(LEVEL ** np.arange(int(np.ceil(np.log1p(most_heard) / np.log(LEVEL))) + 2), dtype=float)
    least_log = float(np.log(max(most_snr, 1e-12))) - LOGS_BELOW
    grid = least_log + LOG_STEP * np.arange(int(LOGS_BELOW / LOG_STEP) + 3)
    return levels, np.log1p(np.exp(grid)[:, None] / levels), least_log


def slot_of(problem: Problem, ground: Ground, n: int, near2: Array, far2: Array, weights: Array | None = None) -> Slot:
    """Return the arrays of slot n.

    near2, far2: (U, K), m^2, of `planner.reach`. weights: (K,) of the users' rates, default 1.
    """
    flying = np.flatnonzero(problem.flying[:, n])
    unit2 = ground.unit_m**2
    gain = problem.snr_gain[flying, :, n] / unit2
    power = ground.power[flying]
    scale = problem.bandwidth_hz[flying] / (1e3 * np.log(2))
    height2 = problem.altitude_m[flying] ** 2 / unit2
    weak = gain / (far2[flying] / unit2)
    least = 1.0 + np.maximum(weak.sum(axis=0) - weak, 0.0) * (1.0 - 1e-9)
    reached = np.sqrt(np.maximum(near2[flying] / unit2 - height2[:, None], 0.0))
    ring = _rings(ground, reached)
    kinds, first, classes = np.unique(ground.classes[flying], return_index=True, return_inverse=True)
    faintest = (gain / power[:, None]).min(axis=0)  # of the users' channels, for unit power
    own = np.ones(gain.shape[1]) if weights is None else weights
    links = Links(
        gain=plain(gain[first]),
        power=plain(power[first, None] * faintest),
        scale=plain(scale[first, None] * own),
        least=plain(np.stack([least[classes == c].min(axis=0) for c in range(len(kinds))])),
        height2=plain(height2[first]),
    )
    return Slot(
        links=links,
        classes=plain(classes.reshape(-1), np.int64),
        least=plain(least),
        ring=plain(ring, np.int64),
        disc=plain(_discs(problem, flying, n) / ground.unit_m),
        free=len(kinds) == 1 and not ring.any(),
    )


def everywhere(problem: Problem, ground: Ground, slot: Slot, n: int) -> Slot:
    """Return the slot as if every UAV could be anywhere in the area: greater, and cheaper to bound for one class."""
    flying = np.flatnonzero(problem.flying[:, n])
    corner2 = (np.maximum(problem.mean_user_m - problem.low_m, problem.high_m - problem.mean_user_m) ** 2).sum(axis=1)
    weak = problem.snr_gain[flying, :, n] / (corner2 + problem.altitude_m[flying, None] ** 2)
    least = 1.0 + np.maximum(weak.sum(axis=0) - weak.max(axis=0), 0.0) * (1.0 - 1e-9)
    inside = np.clip(problem.mean_user_m, problem.low_m, problem.high_m)
    ring = _rings(ground, np.linalg.norm(problem.mean_user_m - inside, axis=1) / ground.unit_m)
    links = slot.links._replace(least=plain(np.broadcast_to(least, slot.links.least.shape)))
    return replace(
        slot,
        links=links,
        least=plain(np.broadcast_to(least, slot.least.shape)),
        ring=plain(np.broadcast_to(ring, slot.ring.shape), np.int64),
        disc=plain(np.column_stack([slot.disc[:, :2], np.full(len(slot.disc), ground.span)])),
        free=len(links.gain) == 1 and not ring.any(),
    )


def _rings(ground: Ground, reached: Array) -> Ints:
    """Return the ring in which a distance lies, or the one before where rounding could tell."""
    found = np.searchsorted(ground.rings[:-1], reached * (1.0 - 1e-9), side="right") - 1
    return np.asarray(np.maximum(found, 0), dtype=np.int64)


def _discs(problem: Problem, flying: Ints, n: int) -> Array:
    """Return the disc around its start in which a UAV must be, or around its end where that is less: (U, 3) m."""
    reach = reach_of(problem)
    from_start, to_end = reach.from_start_m[flying, n], reach.to_end_m[flying, n]
    homing = to_end < from_start
    centre = np.where(homing[:, None], problem.end_m[flying], problem.start_m[flying])
    return np.column_stack([centre, np.where(homing, to_end, from_start)])
