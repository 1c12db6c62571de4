"""Climbing: steer for the links there are, link anew at the new paths, and so on."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import MARGIN, SUM, Arena, Ints, Links, entry, kernel
from skyfolio.planner.fast.ascent import Ascent, ascend, ascent_of
from skyfolio.planner.fast.matching import match_all
from skyfolio.planner.fast.rates import keep_pins, link_rates, slot_signals, value
from skyfolio.planner.fast.shares import copy_links, new_links, share_all, tangent_weights

RELINKS = 4
"""Minorants in a row in each pass."""
CREEP = 1e-4
"""A minorant that gains less than this, relatively, is the last of its pass."""
LONGER, FURTHEST = 2.0, 16.0
"""By how much the next minorant goes further beyond the tangent than the last, and how far at most."""


@entry
def climb(arena: Arena, path: Array, links: Links, steps: int, tolerance: float) -> tuple[int, float, float, bool]:
    """One pass, in place: up to `steps` ascent steps, then new links. What came out as in `worth`; whether it settled.

    It settled when the ascent ended by itself and the new links gained less than `tolerance` of the utility.
    """
    scratch = ascent_of(path, links)
    settled, steered = False, -np.inf
    if steps > 0:
        settled = ascend(arena, links, path, steps, tolerance, scratch) < steps
        _, steered, _ = worth(arena, path, links, scratch)
    relink(arena, path, links, scratch, settled or steps == 0)
    unmet, utility, total = worth(arena, path, links, scratch)
    return unmet, utility, total, settled and utility - steered <= tolerance * abs(utility)


@kernel
def relink(arena: Arena, path: Array, links: Links, scratch: Ascent, settled: bool) -> None:
    """Return the best association and bandwidth at `path` (N, 2, U): exact for `sum`, else better than `links`.

    Minorants are taken beyond the exact tangent, in the direction in which the last one turned, as long as the
    utility grows: on their own they creep. settled: whether paths have come to rest. Until then users with demands
    are not exchanged: trying that takes long, since most of the bands are shared by several.
    """
    thorough = settled or not arena.has_demand
    if arena.kind == SUM and not arena.has_floors:
        match_all(arena, path, links)
        return
    if arena.kind == SUM or links.used[0] == 0:
        share_all(arena, path, links, arena.kind == SUM and thorough)
    if arena.kind == SUM:
        return
    trial, tangent, reach = new_links(links), np.empty(links.log_weight.shape[0]), 1.0
    unmet, utility, _ = worth(arena, path, links, scratch)
    for number in range(RELINKS):
        tangent_weights(arena, links, scratch.rate, tangent, scratch.weight)
        copy_links(links, trial)
        for k in range(tangent.shape[0]):
            trial.log_weight[k] += reach * (tangent[k] - links.log_weight[k])
        share_all(arena, path, trial, number == 0 and thorough)
        new_unmet, new_utility, _ = worth(arena, path, trial, scratch)
        if (-new_unmet, new_utility) > (-unmet, utility):
            copy_links(trial, links)
            if new_utility - utility <= CREEP * abs(new_utility) and new_unmet == unmet:
                return
            unmet, utility, reach = new_unmet, new_utility, min(FURTHEST, reach * LONGER)
        elif reach == 1.0:
            return
        else:
            reach = 1.0
            link_rates(arena, path, links, scratch.rate)


@kernel
def worth(arena: Arena, path: Array, links: Links, scratch: Ascent) -> tuple[int, float, float]:
    """(minimum rates unmet, utility in kbit/s, mean sum rate in kbit/s) of `links` at `path`."""
    rate = scratch.rate
    link_rates(arena, path, links, rate)
    utility = value(arena, links, rate, np.bool_(False), scratch.weight)
    total, unmet = 0.0, 0
    for n in range(path.shape[0]):
        for j in range(links.used[n]):
            total += rate[n, j]
            if arena.has_minimum and not (arena.has_absent and arena.absent[n, links.user[n, j]] != 0):
                unmet += rate[n, j] < arena.min_kbps[links.user[n, j]] * (1.0 - 0.5 * MARGIN)
    return unmet, utility, total / path.shape[0]


@entry
def tables(arena: Arena, path: Array, links: Links, serving: Ints, hertz: Array) -> None:
    """Return who serves each user, (K, N), and with how many Hz, into tables of zeros.

    A user without a link, or who is not there, belongs to the UAV with the strongest signal.
    """
    n_uavs, n_users = path.shape[2], arena.user_m.shape[2]
    signal, total, loudest = np.empty((n_uavs, n_users)), np.empty(n_users), np.empty(n_users)
    for n in range(path.shape[0]):
        if links.used[n] < n_users or arena.has_absent:
            slot_signals(arena, path[n], n, signal, total)
            if arena.has_pinned_to:
                keep_pins(arena, n, signal)
            for k in range(n_users):
                loudest[k] = 0.0
            for u in range(n_uavs):
                for k in range(n_users):
                    if signal[u, k] > loudest[k]:
                        loudest[k] = signal[u, k]
                        serving[k, n] = u
        for j in range(links.used[n]):
            if arena.has_absent and arena.absent[n, links.user[n, j]] != 0:
                continue
            serving[links.user[n, j], n] = links.uav[n, j]
            hertz[links.user[n, j], n] = links.khz[n, j] * 1e3
