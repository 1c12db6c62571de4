"""Rates of the links averaged over draws of the fading, and their slope, link by link."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Links, smooth
from skyfolio.planner.fast.draws import draw_signals, mean_log, pull_draws
from skyfolio.planner.fast.elementary import PER_LN2
from skyfolio.planner.fast.links_narrow import mean_signals


@smooth
def rates_by_draw(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """Mean rate of every link over the draws, kbit/s, into `rate` (N, W). path: (N, 2, U)."""
    gain, draws, user_m, height2 = arena.gain, arena.draws, arena.user_m, arena.height2
    users, uavs, khz, count, per_slot = links.user, links.uav, links.khz, links.used, arena.per_slot
    near, signal = np.empty(path.shape[2]), np.empty(path.shape[2])
    own, others = np.empty(draws.shape[2]), np.empty(draws.shape[2])
    for n in range(path.shape[0]):
        at = n * per_slot
        for j in range(count[n]):
            if khz[n, j] == 0.0:
                rate[n, j] = 0.0
                continue
            u, k = uavs[n, j], users[n, j]
            mean_signals(path, gain, height2, user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k], n, near, signal)
            draw_signals(signal, draws[k], u, own, others)
            rate[n, j] = khz[n, j] * PER_LN2 * mean_log(own, others)


@smooth
def gradient_by_draw(arena: Arena, path: Array, links: Links, weight: Array, slope: Array) -> None:
    """sum_j weight[n, j] d rate[n, j] / d path[n] into `slope` (N, 2, U); 0 in slot 0, which is fixed."""
    gain, draws, user_m, height2 = arena.gain, arena.draws, arena.user_m, arena.height2
    users, uavs, khz, count, per_slot = links.user, links.uav, links.khz, links.used, arena.per_slot
    near, signal = np.empty(path.shape[2]), np.empty(path.shape[2])
    own, others = np.empty(draws.shape[2]), np.empty(draws.shape[2])
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
            mean_signals(path, gain, height2, user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k], n, near, signal)
            draw_signals(signal, draws[k], u, own, others)
            pull_draws(
                path, slope, n, u, user_m[at, 0, k], user_m[at, 1, k], scale, draws[k], own, others, near, signal
            )
