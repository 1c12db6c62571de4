"""Where to begin: hovering, straight flights to hover points, and variations of the best plan so far.

Where to begin matters more than how often, and more than any polish: hover points come from a search of their own
(`placement.py`); in small fleets scattered ones are tried too; then variations of the best plan find better ones than
chance.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, free_uavs, mean_user_m, plain
from skyfolio.planner.fast.flight import fly
from skyfolio.planner.fast.routes import lead

SPREAD_OF_HEIGHT = 2.5
"""Targets further away than this many altitudes are e times less likely: the altitude is the channel's own scale."""


WAYS_OUT, WAYS_OUT_OF_SEPARATION = 12, (1.25, 2.5, 5.0)
"""Directions, and distances in `D_min`, of the points to which a UAV gives way."""


def flown(arena: Arena, wish: Array, *, chase: bool) -> Array | None:
    """Return the flyable path (N, 2, U) that follows `wish`, or None when an end position would be missed."""
    path = np.empty((arena.gain.shape[0], 2, arena.gain.shape[1]))
    return path if fly(arena, wish, chase, path) else None


def hovering(arena: Arena) -> Array | None:
    """Everyone stays at the start as long as its end allows: (N, 2, U) metres.

    Where that lets UAVs meet on their ways, ends are sought at once, or half of the UAVs go first; where it costs too
    much energy, they go slowly. Where it is in the way of pinned UAVs, the others give way.
    """
    n_slots, n_uavs = arena.gain.shape
    stay = np.repeat(arena.start_m[None], n_slots, axis=0)
    path = flown(arena, stay, chase=True)
    if path is not None or not (arena.has_ends or arena.has_pinned):
        return path
    path = _one_after_the_other(arena) if arena.has_pinned else None
    if path is not None or not arena.has_ends:
        return path
    early = stay.copy()
    for u in range(n_uavs):
        if not np.isnan(arena.end_m[0, u]):
            lead(arena, u, arena.end_m[:, u].copy(), 0, early)
    for first in (slice(0, n_uavs), slice(0, n_uavs, 2), slice(1, n_uavs, 2)):
        wish = stay.copy()
        wish[:, :, first] = early[:, :, first]
        path = flown(arena, wish, chase=True)
        if path is not None:
            return path
    return flown(arena, _unhurried(arena, stay), chase=True) if arena.has_energy else None


def _unhurried(arena: Arena, stay: Array) -> Array:
    """Return straight ways to the ends that take until the last slot: hovering costs more than flying slowly."""
    share = np.minimum(np.arange(len(stay))[:, None] / np.maximum(arena.last, 1), 1.0)[:, None]
    way = np.nan_to_num(arena.end_m - arena.start_m)
    straight: Array = stay + share * way[None]
    return straight


def _one_after_the_other(arena: Arena) -> Array | None:
    """Return paths (N, 2, U) on which each free UAV in turn gives way to the pinned ones and to those before it.

    It hovers, or goes to one of a few points around its start; the UAVs after it are not in the air yet. None when one
    finds no such way.
    """
    path, last = arena.pinned.copy(), np.where(np.isnan(arena.pinned[0, 0]), 0, arena.last)
    for u in free_uavs(arena):
        last[u] = arena.last[u]
        found = _giving_way(arena._replace(pinned=path.copy(), last=plain(last, np.int64)), int(u))
        if found is None:
            return None
        path[:, :, u] = found
    return path


def _giving_way(arena: Arena, u: int) -> Array | None:
    """Return the first way (N, 2) of UAV u, among a few, on which it keeps apart from the pinned UAVs."""
    angle = 2.0 * np.pi * np.arange(WAYS_OUT) / WAYS_OUT
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = [np.zeros(2), *(share * arena.separation_m * way for share in WAYS_OUT_OF_SEPARATION for way in around)]
    for point in points:
        wish = np.repeat(arena.start_m[None], arena.gain.shape[0], axis=0)
        target = plain(np.clip(arena.start_m[:, u] + point, arena.low, arena.high))
        lead(arena, u, target, 0, wish)
        path = flown(arena, wish, chase=True)
        if path is not None:
            return path[:, :, u]
    return None


def bound_for(arena: Arena, place_m: Array) -> Array | None:
    """Return the paths (N, 2, U) straight to `place_m` (2, U), around zones.

    UAVs hover there, and go on to their ends in time.
    """
    wish = np.repeat(arena.start_m[None], arena.gain.shape[0], axis=0)
    for u, target in enumerate(place_m.T):
        lead(arena, u, plain(target), 0, wish)
    return flown(arena, wish, chase=True)


def bound(arena: Arena, path: Array) -> Array:
    """Return where UAVs on `path` (N, 2, U) are bound for: (2, U).

    That is where each is late in its flight or, if it must go on to an end, half-way.
    """
    share = np.where(np.isnan(arena.end_m[0]), 0.9, 0.5)
    slots = (share * np.minimum(arena.last, path.shape[0] - 1)).astype(int)
    return plain(path[slots, :, np.arange(path.shape[2])].T)


def scattered(arena: Arena, rng: np.random.Generator) -> Array | None:
    """Return paths (N, 2, U) to places over users drawn at random, near ones likelier; None if not flyable."""
    return bound_for(arena, _scattered(arena, rng))


def varied(arena: Arena, rng: np.random.Generator, best: Array) -> Array | None:
    """Return the best paths (N, 2, U) with one or two UAVs sent elsewhere; None if they cannot be flown."""
    return flown(arena, _varied(arena, rng, best), chase=True)


def _scattered(arena: Arena, rng: np.random.Generator) -> Array:
    """(2, U): places over users, distinct while they last, drawn so that near ones are likelier."""
    start, users = arena.start_m[:, :, None], mean_user_m(arena)[:, None, :]
    away = np.hypot(*(start - users))  # (U, K)
    cost = away / _spread(arena) - rng.gumbel(size=away.shape)
    chosen = linear_sum_assignment(cost)[1] if away.shape[0] <= away.shape[1] else cost.argmin(axis=1)
    points: Array = np.clip(mean_user_m(arena)[:, chosen], arena.low[:, None], arena.high[:, None])
    return points


def _varied(arena: Arena, rng: np.random.Generator, best: Array) -> Array:
    """Return the best paths (N, 2, U), with one or two UAVs sent to another user near by, at once or later on."""
    n_slots, free = best.shape[0], free_uavs(arena)
    wish = best.copy()
    if not len(free):
        return wish
    user_m = mean_user_m(arena)
    for u in rng.choice(free, size=min(len(free), int(rng.integers(1, 3))), replace=False):
        away = np.hypot(*(user_m - best[-1, :, u][:, None]))
        likely = np.exp(-(away - away.min()) / _spread(arena))
        target = user_m[:, rng.choice(len(likely), p=likely / likely.sum())]
        begin = int(rng.integers(0, n_slots)) if rng.random() < 0.5 else 0
        lead(arena, u, plain(np.clip(target, arena.low, arena.high)), begin, wish)
    return wish


def _spread(arena: Arena) -> float:
    return float(SPREAD_OF_HEIGHT * np.sqrt(arena.height2).mean())
