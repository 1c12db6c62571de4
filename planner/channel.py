"""The air-to-ground channel: eqs. (1)-(4) of the letter."""

from __future__ import annotations

from collections.abc import Sequence
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.corrections import link_factors

ANGLE = np.uint64(0xD1B54A32D192ED03)
ORDER = np.uint64(0x8CB92BA72F3D8DD7)
"""Separate streams of one key."""
HELD_BY_PLANNER = np.uint64(2**63)
"""Draws of `expected_gains` count from here: no slot does."""


def squared_distances(paths_m: Array, user_m: Array, altitude_m: Array, spread_m2: Array) -> Array:
    """Return `d_uk^2[n]` of eq. (1): (U, K, N) m^2.

    paths_m: (U, N, 2) and user_m: (K, N or 1, 2), metres east/north; altitude_m: (U,). spread_m2: (K, N or 1), the mean
    squared distance of users from their places, m^2.
    """
    apart = paths_m[:, None, :, :] - user_m[None]
    squared: Array = np.einsum("uknd,uknd->ukn", apart, apart) + altitude_m[:, None, None] ** 2
    squared += spread_m2
    return squared


def sum_of_others(values: Array) -> Array:
    """Return the sum of all other entries along axis 0; added up rather than subtracted, so that nothing cancels."""
    others = np.zeros_like(values)
    others[1:] = np.cumsum(values[:-1], axis=0)
    others[:-1] += np.cumsum(values[:0:-1], axis=0)[::-1]
    return others


def fading_gains(
    channel: RadioChannel, uav_ids: Sequence[str], user_ids: Sequence[str], first_slot: int, n_slots: int
) -> Array:
    """Return small-scale power gains |h|^2 of eq. (2), mean 1, times the corrections of the links: (U, K, N).

    `"mean"` is all ones. `"sampled"` draws Rician gains that depend only on (seed, uav id, user id, slot), so that a
    replan with fewer UAVs, other users or later slots sees the very same channel. `"held"` gives each link the draw of
    slot 0 for all slots. `"expected"` has no gains: its rates are means over those of `expected_gains`.
    """
    shape = (len(uav_ids), len(user_ids), n_slots)
    if channel.fading == "expected":
        return np.ones(shape)
    if channel.fading == "mean":
        return _corrected(channel, uav_ids, user_ids, np.ones(shape))
    drawn = np.arange(first_slot, first_slot + n_slots, dtype=np.uint64)
    slot = (np.zeros_like(drawn) if channel.fading == "held" else drawn)[None, None, :]
    key = _link_keys(channel, uav_ids, user_ids) ^ slot
    return _corrected(channel, uav_ids, user_ids, _rician(channel, _uniform(_mix(key)), _uniform(_mix(key ^ ANGLE))))


def expected_gains(channel: RadioChannel, uav_ids: Sequence[str], user_ids: Sequence[str]) -> Array:
    """Return the S common draws of |h|^2 over which rates are averaged: (S, U, K), `channel.draws` of them.

    Corrections of links are factors of them too.
    The same draws serve all slots and all paths, so that paths are compared on equal terms. They depend only on
    (seed, uav id, user id), and not one of them is a draw of `fading_gains`. Each link's draws are stratified (one from
    each S-th of both distributions behind a Rician gain, in an order of its own), so that no link looks lucky; a single
    draw is a plain one.
    """
    n_draws = channel.draws
    ordinal = np.arange(n_draws, dtype=np.uint64)[None, None, :]
    key = _link_keys(channel, uav_ids, user_ids) ^ (HELD_BY_PLANNER + ordinal)
    uniforms = []
    for salt in (np.uint64(0), ANGLE):
        order = _mix(_mix(key ^ salt) ^ ORDER).argsort(axis=2).argsort(axis=2)
        uniforms.append((order + _uniform(_mix(key ^ salt))) / n_draws)
    drawn = _corrected(channel, uav_ids, user_ids, _rician(channel, *uniforms))
    return np.ascontiguousarray(drawn.transpose(2, 0, 1))


def _corrected(channel: RadioChannel, uav_ids: Sequence[str], user_ids: Sequence[str], gains: Array) -> Array:
    """Return gains (U, K, ...) times the corrections of their links."""
    if not channel.corrections_db:
        return gains
    corrected: Array = gains * link_factors(channel.corrections_db, uav_ids, user_ids)[:, :, None]
    return corrected


def _link_keys(channel: RadioChannel, uav_ids: Sequence[str], user_ids: Sequence[str]) -> NDArray[np.uint64]:
    """Return a key of each pair: (U, K, 1)."""
    uav = np.array([crc32(one.encode()) for one in uav_ids], dtype=np.uint64)[:, None, None]
    user = np.array([crc32(one.encode()) for one in user_ids], dtype=np.uint64)[None, :, None]
    return _mix(_mix(_mix(np.full(1, channel.seed, dtype=np.uint64)) ^ uav) ^ user)


def _rician(channel: RadioChannel, first: Array, second: Array) -> Array:
    """Return the Rician gain of eq. (2) from two uniform numbers in (0, 1), for scattered amplitude and phase."""
    radius, angle = np.sqrt(-np.log(first)), 2 * np.pi * second  # |CN(0, 1)| and its phase
    rician = 10 ** (channel.rician_k_db / 10)  # `M` of eq. (1)
    line_of_sight, scattered = np.sqrt(rician / (rician + 1)), np.sqrt(1 / (rician + 1)) * radius
    gains: Array = (line_of_sight + scattered * np.cos(angle)) ** 2 + (scattered * np.sin(angle)) ** 2
    return gains


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Apply SplitMix64's finaliser: a counter-based generator, so that each draw depends on its key alone."""
    z = x + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def _uniform(bits: NDArray[np.uint64]) -> Array:
    """Return uniform numbers strictly inside (0, 1)."""
    return ((bits >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53
