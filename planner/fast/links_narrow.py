"""Rates of the links and their slope, link by link: the loop over UAVs is the inner one. For narrow tables of links."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Links, smooth
from skyfolio.planner.fast.elementary import PER_LN2, log


@smooth
def mean_signals(
    path: Array,
    gain: Array,
    height2: Array,
    east: float,
    north: float,
    spread: float,
    n: int,
    near: Array,
    signal: Array,
) -> None:
    """1/d^2 and SNR of every UAV at (east, north) in slot n, into `near` and `signal`, both (U,).

    spread: m^2, added to squared distances.
    """
    for i in range(near.shape[0]):
        de, dn = path[n, 0, i] - east, path[n, 1, i] - north
        near[i] = 1.0 / (de * de + dn * dn + (height2[i] + spread))
        signal[i] = gain[n, i] * near[i]


@smooth
def _faded_signals(
    path: Array,
    fading: Array,
    height2: Array,
    east: float,
    north: float,
    spread: float,
    n: int,
    k: int,
    near: Array,
    signal: Array,
) -> None:
    """Return the same with the sampled gains of user k."""
    for i in range(near.shape[0]):
        de, dn = path[n, 0, i] - east, path[n, 1, i] - north
        near[i] = 1.0 / (de * de + dn * dn + (height2[i] + spread))
        signal[i] = fading[n, i, k] * near[i]


@smooth
def sum_without(signal: Array, u: int) -> float:
    """1 + the sum of all but entry u, which is set to 0: nothing is subtracted, so nothing cancels."""
    signal[u] = 0.0
    total = 1.0
    for i in range(signal.shape[0]):
        total += signal[i]
    return total


@smooth
def rates_by_link(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """Rate of every link, kbit/s, into `rate` (N, W). path: (N, 2, U)."""
    # Fields are read once, out here: inside the loops numba would count references to each of them.
    gain, fading, user_m, height2 = arena.gain, arena.fading, arena.user_m, arena.height2
    users, uavs, khz, count, per_slot = links.user, links.uav, links.khz, links.used, arena.per_slot
    near, signal = np.empty(path.shape[2]), np.empty(path.shape[2])
    sampled = fading.shape[0] > 0
    for n in range(path.shape[0]):
        at = n * per_slot
        for j in range(count[n]):
            if khz[n, j] == 0.0:
                rate[n, j] = 0.0
                continue
            u, k = uavs[n, j], users[n, j]
            if sampled:
                _faded_signals(
                    path, fading, height2, user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k], n, k, near, signal
                )
            else:
                mean_signals(path, gain, height2, user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k], n, near, signal)
            own = signal[u]
            others = sum_without(signal, u)
            rate[n, j] = khz[n, j] * PER_LN2 * log((own + others) / others)


@smooth
def gradient_by_link(arena: Arena, path: Array, links: Links, weight: Array, slope: Array) -> None:
    """sum_j weight[n, j] d rate[n, j] / d path[n] into `slope` (N, 2, U); 0 in slot 0, which is fixed."""
    gain, fading, user_m, height2 = arena.gain, arena.fading, arena.user_m, arena.height2
    users, uavs, khz, count, per_slot = links.user, links.uav, links.khz, links.used, arena.per_slot
    near, signal = np.empty(path.shape[2]), np.empty(path.shape[2])
    sampled = fading.shape[0] > 0
    for n in range(path.shape[0]):
        for i in range(path.shape[2]):
            slope[n, 0, i] = slope[n, 1, i] = 0.0
        if n == 0:
            continue
        at = n * per_slot
        for j in range(count[n]):
            scale = weight[n, j] * khz[n, j] * PER_LN2
            if scale == 0.0:
                continue
            u, k = uavs[n, j], users[n, j]
            if sampled:
                _faded_signals(
                    path, fading, height2, user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k], n, k, near, signal
                )
            else:
                mean_signals(path, gain, height2, user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k], n, near, signal)
            own = signal[u]
            others = sum_without(signal, u)
            pull_link(path, slope, n, u, user_m[at, 0, k], user_m[at, 1, k], scale, own, others, near, signal)


@smooth
def pull_link(
    path: Array,
    slope: Array,
    n: int,
    u: int,
    east: float,
    north: float,
    scale: float,
    own: float,
    others: float,
    near: Array,
    signal: Array,
) -> None:
    """Add the slope of one link: it pulls its UAV u to the user and pushes the others away."""
    push = 2.0 * scale * own / ((own + others) * others)
    for i in range(near.shape[0]):
        strength = push * signal[i] * near[i]
        slope[n, 0, i] += strength * (path[n, 0, i] - east)
        slope[n, 1, i] += strength * (path[n, 1, i] - north)
    strength = 2.0 * scale * own * near[u] / (own + others)
    slope[n, 0, u] -= strength * (path[n, 0, u] - east)
    slope[n, 1, u] -= strength * (path[n, 1, u] - north)
