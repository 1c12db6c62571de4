"""Rates of the links of a channel that is no inverse square, and their slope, link by link."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Links, smooth
from skyfolio.planner.fast.bent import bent_signals, hear_bent, hear_map, lean_draws, lean_link, map_signals
from skyfolio.planner.fast.draws import draw_signals, equivalent_of, mean_log, pull_draws
from skyfolio.planner.fast.elementary import PER_LN2, log
from skyfolio.planner.fast.links_narrow import pull_link, sum_without


@smooth
def slot_signals_bent(arena: Arena, at: Array, n: int, signal: Array, total: Array) -> None:
    """SNR of every pair of slot n into `signal` (U, K), 1 + their sum into `total` (K,). at: (2, U), positions."""
    bend, here, height2 = arena.bend, arena.user_m[n * arena.per_slot], arena.height2
    table, row, per_metre = bend.factor, bend.row, bend.per_metre
    sampled, mapped = arena.fading.shape[0] > 0, bend.logs.shape[0] > 0
    for k in range(signal.shape[1]):
        total[k] = 1.0
    for u in range(signal.shape[0]):
        gain = arena.fading[n, u] if sampled else arena.gain[n, u : u + 1]
        which = row[u]
        hear_bent(here, gain, at[0, u], at[1, u], height2[u], table, per_metre[which], which, signal[u])
        if mapped:
            hear_map(bend, n * arena.per_slot, at[0, u], at[1, u], which, signal[u])
        for k in range(signal.shape[1]):
            total[k] += signal[u, k]
    if arena.draws.shape[2] > 0:
        own, others = np.empty(arena.draws.shape[2]), np.empty(arena.draws.shape[2])
        for k in range(signal.shape[1]):
            equivalent_of(signal[:, k].copy(), arena.draws[k], own, others, signal, total, k)


@smooth
def rates_by_bent_link(arena: Arena, path: Array, links: Links, rate: Array) -> None:
    """Rate of every link, kbit/s, into `rate` (N, W). path: (N, 2, U)."""
    gain, fading, user_m, height2, draws, bend = (
        arena.gain,
        arena.fading,
        arena.user_m,
        arena.height2,
        arena.draws,
        arena.bend,
    )
    table, row, per_metre = bend.factor, bend.row, bend.per_metre
    users, uavs, khz, count, per_slot = links.user, links.uav, links.khz, links.used, arena.per_slot
    near, signal, lean, mapped = (
        np.empty(path.shape[2]),
        np.empty(path.shape[2]),
        np.empty(path.shape[1:]),
        bend.logs.shape[0] > 0,
    )
    own_of, others_of = np.empty(draws.shape[2]), np.empty(draws.shape[2])
    for n in range(path.shape[0]):
        at = n * per_slot
        for j in range(count[n]):
            if khz[n, j] == 0.0:
                rate[n, j] = 0.0
                continue
            u, k = uavs[n, j], users[n, j]
            east, north, spread = user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k]
            bent_signals(path, gain, fading, height2, table, row, per_metre, east, north, spread, n, k, near, signal)
            if mapped:
                map_signals(path, bend, at, n, k, signal, lean)
            if draws.shape[2] > 0:
                draw_signals(signal, draws[k], u, own_of, others_of)
                rate[n, j] = khz[n, j] * PER_LN2 * mean_log(own_of, others_of)
                continue
            own = signal[u]
            others = sum_without(signal, u)
            rate[n, j] = khz[n, j] * PER_LN2 * log((own + others) / others)


@smooth
def gradient_by_bent_link(arena: Arena, path: Array, links: Links, weight: Array, slope: Array) -> None:
    """sum_j weight[n, j] d rate[n, j] / d path[n] into `slope` (N, 2, U); 0 in slot 0, which is fixed."""
    gain, fading, user_m, height2, draws, bend = (
        arena.gain,
        arena.fading,
        arena.user_m,
        arena.height2,
        arena.draws,
        arena.bend,
    )
    table, row, per_metre = bend.factor, bend.row, bend.per_metre
    users, uavs, khz, count, per_slot = links.user, links.uav, links.khz, links.used, arena.per_slot
    near, signal, lean, mapped = (
        np.empty(path.shape[2]),
        np.empty(path.shape[2]),
        np.empty(path.shape[1:]),
        bend.logs.shape[0] > 0,
    )
    own_of, others_of = np.empty(draws.shape[2]), np.empty(draws.shape[2])
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
            east, north, spread = user_m[at, 0, k], user_m[at, 1, k], user_m[at, 2, k]
            bent_signals(path, gain, fading, height2, table, row, per_metre, east, north, spread, n, k, near, signal)
            if mapped:
                map_signals(path, bend, at, n, k, signal, lean)
            if draws.shape[2] > 0:
                draw_signals(signal, draws[k], u, own_of, others_of)
                pull_draws(path, slope, n, u, east, north, scale, draws[k], own_of, others_of, near, signal)
                if mapped:
                    lean_draws(slope, n, u, scale, draws[k], own_of, others_of, lean, signal)
                continue
            own = signal[u]
            others = sum_without(signal, u)
            pull_link(path, slope, n, u, east, north, scale, own, others, near, signal)
            if mapped:
                lean_link(slope, n, u, scale, own, others, lean, signal)
