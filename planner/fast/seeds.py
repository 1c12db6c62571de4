"""Where to begin: hovering, and flights to different hover points. Multi-start gains more than any polish."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment

from planner.fast.arena import Arena, Array, Flag
from planner.fast.flight import fly


def flown(arena: Arena, wish: Array, *, chase: Flag) -> Array | None:
    """The flyable path (N, 2, U) that follows `wish`, or None when an end position would be missed."""
    path = np.empty((arena.gain.shape[0], 2, arena.gain.shape[1]))
    return path if fly(arena, wish, chase, path) else None


def hovering(arena: Arena) -> Array | None:
    """Everyone stays at the start as long as its end position allows: (N, 2, U) metres."""
    return flown(arena, np.zeros((arena.gain.shape[0], 2, arena.gain.shape[1])), chase=False)


def flights(arena: Arena, count: int, seed: int) -> Iterator[Array]:
    """`count` paths (N, 2, U) that fly straight to hover points over distinct users, and hover there."""
    rng = np.random.default_rng(seed)
    n_slots = arena.gain.shape[0]
    for _ in range(count):
        wish = np.repeat(_hover_points(arena, rng)[None], n_slots, axis=0)
        path = flown(arena, wish, chase=True)
        if path is not None:
            yield path


def _hover_points(arena: Arena, rng: np.random.Generator) -> Array:
    """(2, U): places over users drawn at random, distinct while they last, each to the UAV that is nearest overall."""
    n_uavs, n_users = arena.gain.shape[1], arena.user_m.shape[1]
    drawn = rng.permutation(n_users)[:n_uavs]
    if n_users < n_uavs:
        drawn = np.concatenate([drawn, rng.integers(0, n_users, n_uavs - n_users)])
    points = np.clip(arena.user_m[:, drawn], arena.low[:, None], arena.high[:, None])
    away = ((arena.start_m[:, :, None] - points[:, None, :]) ** 2).sum(axis=0)
    matched: Array = points[:, linear_sum_assignment(away)[1]]
    return np.ascontiguousarray(matched)
