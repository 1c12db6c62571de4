"""The air-to-ground channel: eqs. (1)-(4) of the letter."""

from __future__ import annotations

from collections.abc import Sequence
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.scenario import Channel


def squared_distances(paths_m: Array, user_m: Array, altitude_m: Array) -> Array:
    """Return `d_uk^2[n]` of eq. (1): (U, K, N) m^2.

    paths_m: (U, N, 2) and user_m: (K, 2), metres east/north; altitude_m: (U,).
    """
    apart = paths_m[:, None, :, :] - user_m[None, :, None, :]
    squared: Array = np.einsum("uknd,uknd->ukn", apart, apart) + altitude_m[:, None, None] ** 2
    return squared


def sum_of_others(values: Array) -> Array:
    """Return the sum of all other entries along axis 0; added up rather than subtracted, so that nothing cancels."""
    others = np.zeros_like(values)
    others[1:] = np.cumsum(values[:-1], axis=0)
    others[:-1] += np.cumsum(values[:0:-1], axis=0)[::-1]
    return others


def fading_gains(
    channel: Channel, uav_ids: Sequence[str], user_ids: Sequence[str], first_slot: int, n_slots: int
) -> Array:
    """Return small-scale power gains |h|^2 of eq. (2): (U, K, N), mean 1.

    `"mean"` is all ones. `"sampled"` draws Rician gains that depend only on (seed, uav id, user id, slot), so that a
    replan with fewer UAVs, other users or later slots sees the very same channel. `"held"` gives each link the draw of
    slot 0 for all slots.
    """
    shape = (len(uav_ids), len(user_ids), n_slots)
    if channel.fading == "mean":
        return np.ones(shape)
    uav = np.array([crc32(one.encode()) for one in uav_ids], dtype=np.uint64)[:, None, None]
    user = np.array([crc32(one.encode()) for one in user_ids], dtype=np.uint64)[None, :, None]
    drawn = np.arange(first_slot, first_slot + n_slots, dtype=np.uint64)
    slot = (np.zeros_like(drawn) if channel.fading == "held" else drawn)[None, None, :]
    key = _mix(_mix(_mix(np.full(1, channel.seed, dtype=np.uint64)) ^ uav) ^ user) ^ slot
    radius = np.sqrt(-np.log(_uniform(_mix(key))))  # |CN(0, 1)|
    angle = 2 * np.pi * _uniform(_mix(key ^ np.uint64(0xD1B54A32D192ED03)))
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
