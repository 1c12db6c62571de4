"""Where the whole fleet hovers to begin with: the default method's sketches, for some of the users."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import arena_of
from skyfolio.planner.fast.placement import Effort, places
from skyfolio.planner.problem import Problem

USERS_PER_UAV = 20
"""Whom sketches look at: which user in a neighbourhood is best is for the areas to find."""
SKETCHES, TRIES_PER_UAV = 12, 100


def sketched(problem: Problem, seed: int, halted: Callable[[], bool]) -> Array:
    """Return hover points for the whole fleet, (U, 2) metres; its starts when there was no time for any."""
    arena = arena_of(with_some_users(problem, USERS_PER_UAV * problem.n_uavs, seed))
    effort = Effort(SKETCHES, 1, TRIES_PER_UAV * problem.n_uavs)
    found = places(arena, np.random.default_rng(seed), effort, halted=halted)
    return found[0].T.copy() if found else problem.start_m.copy()


def with_some_users(problem: Problem, some: int, seed: int) -> Problem:
    """Return the problem with `some` of its users, drawn at random; all of them where they are no more."""
    if problem.n_users <= some:
        return problem
    drawn = np.sort(np.random.default_rng(seed).choice(problem.n_users, some, replace=False))
    return of_users(problem, drawn)


def of_users(problem: Problem, users: Array) -> Problem:
    """Return the problem with these users alone."""
    return replace(
        problem,
        snr_gain=problem.snr_gain[:, users] if problem.snr_gain.strides[1] else _alike(problem.snr_gain, len(users)),
        user_m=problem.user_m[users],
        past_kbps=problem.past_kbps[users],
        min_kbps=problem.min_kbps[users],
    )


def _alike(snr_gain: Array, n_users: int) -> Array:
    return np.broadcast_to(snr_gain[:, :1], (len(snr_gain), n_users, snr_gain.shape[2]))
