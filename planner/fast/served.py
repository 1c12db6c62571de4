"""The rates of a solution, to the last digit, for the plan that is emitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Ints, bend_of, entry, is_mean, plain
from skyfolio.planner.fast.bent import Bend, bent, map_at
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution
from skyfolio.planner.utility import TINY


def served_rates_bps(problem: Problem, solution: Solution) -> Array:
    """Return what each user gets in each slot, eqs. (1)-(4): (K, N) bit/s."""
    return _served(
        plain(problem.snr_gain[:, :1] if is_mean(problem) else problem.snr_gain),
        plain(problem.draws.transpose(2, 1, 0)),
        plain(np.concatenate([problem.user_m, problem.spread_m2[:, :, None]], axis=2)),
        plain(problem.altitude_m),
        plain(solution.paths_m),
        plain(solution.serving, np.int64),
        plain(solution.bandwidth_hz),
        bend_of(problem),
    )


def as_asked(problem: Problem, solution: Solution) -> Solution:
    """Return the solution without the band that users have beyond what they ask for: it stays free."""
    if not problem.has_demand:
        return solution
    rates_kbps = served_rates_bps(problem, solution) / 1e3
    share = np.minimum(1.0, problem.demand_kbps[:, None] / np.maximum(rates_kbps, TINY))
    return replace(solution, bandwidth_hz=solution.bandwidth_hz * share)


@entry
def _served(
    snr_gain: Array,
    draws: Array,
    user_m: Array,
    altitude_m: Array,
    paths_m: Array,
    serving: Ints,
    hertz: Array,
    bend: Bend,
) -> Array:
    """snr_gain: (U, K, N), or (U, 1, N) when all users share one. draws: (K, U, S), or empty.

    user_m: (K, N or 1, 3), places and spreads.
    """
    n_users, n_slots = serving.shape
    rates = np.zeros((n_users, n_slots))
    sampled = snr_gain.shape[1] > 1
    n_draws = draws.shape[2]
    is_bent, is_mapped = bend.factor.shape[0] > 0, bend.logs.shape[0] > 0
    snr = np.empty(paths_m.shape[0])
    for k in range(n_users):
        row = k if sampled else 0
        for n in range(n_slots):
            if hertz[k, n] == 0.0:
                continue
            at = min(n, user_m.shape[1] - 1)
            east, north, spread = user_m[k, at, 0], user_m[k, at, 1], user_m[k, at, 2]
            for u in range(paths_m.shape[0]):
                de, dn = paths_m[u, n, 0] - east, paths_m[u, n, 1] - north
                snr[u] = snr_gain[u, row, n] / (de * de + dn * dn + altitude_m[u] * altitude_m[u] + spread)
                if is_bent:
                    which = bend.row[u]
                    snr[u] *= bent(bend.factor, which, bend.per_metre[which], de * de + dn * dn + spread)[0]
                    if is_mapped:
                        snr[u] *= map_at(bend, which, bend.reads[at, k], paths_m[u, n, 0], paths_m[u, n, 1])
            total = 0.0
            for s in range(max(n_draws, 1)):
                own, others = 0.0, 1.0
                for u in range(snr.shape[0]):
                    heard = snr[u] * draws[k, u, s] if n_draws > 0 else snr[u]
                    if u == serving[k, n]:
                        own = heard
                    else:
                        others += heard
                total += np.log1p(own / others)
            rates[k, n] = hertz[k, n] * total / max(n_draws, 1) / np.log(2.0)
    return rates
