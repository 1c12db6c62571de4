"""Derivatives at the plan: what a little more band, speed or head start is worth, with all other choices kept."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.explanation.ledger import LN2, Ledger

TOUCHING = 1e-6
"""Relative: a step this little shorter than the longest is the longest."""


def band_prices(ledger: Ledger) -> Array:
    """Return what one hertz more in every slot is worth to each UAV: (U,), bit/s of utility per hertz."""
    prices: Array = ledger.earned_kbps.sum(axis=1) * 1e3 / ledger.problem.bandwidth_hz
    return prices


def full_slots(ledger: Ledger) -> Array:
    """Return in how many slots each UAV gives away its whole band: (U,)."""
    full: Array = (ledger.by_uav(ledger.bandwidth_hz) >= ledger.problem.bandwidth_hz[:, None] * (1 - TOUCHING)).sum(
        axis=1
    )
    return full


def slope_kbps(ledger: Ledger, u: int) -> Array:
    """Return the gradient of the utility in the positions of UAV `u`, links kept: (N, 2), kbit/s per metre.

    With the signal s of this UAV at a user, T all signals and I the interfering ones there, the rate is
    b log2((1 + T) / (1 + I)): s is part of T always, and of I unless this UAV serves the user.
    """
    problem = ledger.problem
    east, north = (ledger.paths_m[u, :, axis] - problem.user_m[:, :, axis] for axis in (0, 1))  # (K, N)
    distance2 = east * east + north * north + (problem.altitude_m[u] ** 2 + problem.spread_m2)
    bent, slope = problem.bent(u, east * east + north * north + problem.spread_m2)
    excess = problem.excess
    factor, to_east, to_north = (1.0, 0.0, 0.0) if excess is None else excess.of_uav(u, ledger.paths_m[u])
    snr = problem.snr_gain[u] / distance2 * bent * factor
    interfering = np.where(ledger.serving == u, 0.0, 1.0 / (1.0 + ledger.total_snr - ledger.own_snr))
    by_snr = ledger.weights * ledger.bandwidth_hz / (1e3 * LN2) * (1.0 / (1.0 + ledger.total_snr) - interfering)
    by_metre = (
        by_snr * -2.0 * snr * (1.0 / distance2 - slope / bent) if problem.bends else by_snr * -2.0 * snr / distance2
    )
    by_log = by_snr * snr
    ways = (by_metre * east + by_log * to_east, by_metre * north + by_log * to_north)
    return np.stack([way.sum(axis=0) for way in ways], axis=1)


def speed_price(ledger: Ledger, u: int) -> tuple[int, float | None]:
    """Return in how many slots UAV `u` flies at its greatest speed, and what 1 m/s more is worth, bit/s of utility.

    The multipliers of (6d): where a step is as long as it may be, the sum of the slopes of all later positions up to
    the next shorter step points along the step, and its length there is what a metre is worth. With an end position
    steps after the last shorter one are left out, and the price is None if there is no such step. A pinned path would
    not be flown faster.
    """
    problem = ledger.problem
    if ledger.is_pinned(u):
        return 0, None
    last = int(problem.n_flying[u])
    steps = np.diff(ledger.paths_m[u][:last], axis=0)  # step n leads from slot n to slot n + 1
    length = np.linalg.norm(steps, axis=1)
    longest = problem.step_m[u] if problem.air is None else problem.air.of([u]).longest_m(steps[None])[0]
    tight = length >= longest * (1 - TOUCHING)
    if not tight.any() or problem.step_m[u] == 0.0:
        return 0, None
    anchor = len(steps)
    if np.isfinite(problem.end_m[u]).all():
        slack = np.flatnonzero(~tight)
        if not len(slack):
            return int(tight.sum()), None
        anchor = int(slack[-1])
    slope = slope_kbps(ledger, u)
    pull, worth = np.zeros(2), 0.0
    for n in range(anchor - 1, -1, -1):
        pull = pull + slope[n + 1]
        if not tight[n]:
            pull = np.zeros(2)
            continue
        worth += max(0.0, float(pull @ steps[n]) / length[n])
    seconds = ledger.scenario.slot_duration_s
    return int(tight.sum()), worth * seconds * 1e3


def head_start_kbps(ledger: Ledger, u: int) -> tuple[float, float]:
    """Return what a head start of one slot along its own path is worth to UAV `u`: kbit/s of utility, and of sum rate.

    It hovers a slot longer at the end instead. Links are kept: the difference is exact for these paths, and the first
    order of what a moved start is worth.
    """
    last = int(ledger.problem.n_flying[u]) - 1
    path = ledger.paths_m[u][np.minimum(np.arange(ledger.problem.n_slots) + 1, last)]
    change = ledger.snr_of(u, path) - ledger.snr_of(u)
    interfering = ledger.total_snr - ledger.own_snr + np.where(ledger.serving == u, 0.0, change)
    own = ledger.own_snr + np.where(ledger.serving == u, change, 0.0)
    rates = ledger.bandwidth_hz / (1e3 * LN2) * np.log1p(own / (1.0 + np.maximum(interfering, 0.0)))
    rates = np.minimum(rates, ledger.problem.demand_kbps[:, None])
    gain = ledger.utility_kbps(rates) - ledger.utility_kbps(ledger.rates_kbps)
    return gain, float((rates - ledger.rates_kbps).sum() / ledger.problem.n_slots)
