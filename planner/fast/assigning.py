"""Under `sum` without minimum rates: whole bands assigned slot by slot when users that change UAVs cost a toll."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from skyfolio.planner.arrays import Array
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.problem import Problem
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solution import Solution

Users: TypeAlias = NDArray[np.intp]
Flags: TypeAlias = NDArray[np.bool_]
SWEEPS = 6
OVERTAKING = (1.0, 0.5, 0.25)
"""A slot's next assignment is tried at these shares of the slope, since the slope falls as the slot gains."""


@dataclass(frozen=True, kw_only=True)
class Tolls:
    """What changes cost, in kbit/s of utility.

    former_m: (U, N, 2) metres, NaN where a UAV may fly for nothing. serving: (K, N), who served before, -1 where that
    costs nothing; served: (K, N), whether the user had bandwidth then. per_metre: in one slot; per_user: in one slot,
    where the user has bandwidth before or after.
    """

    former_m: Array
    serving: Users
    served: Flags
    per_metre: float
    per_user: float

    def changed(self, serving: Users, bandwidth_hz: Array) -> Flags:
        """Return which users pay in which slots: (K, N)."""
        concerned = (self.serving >= 0) & (self.served | (bandwidth_hz > 0.0))
        paying: Flags = concerned & (serving != self.serving)
        return paying


def settled(problem: Problem, tolls: Tolls, serving: Users, hertz: Array) -> Users:
    """Return the servers (K, N) with those of users without bandwidth as before, where nothing else is pinned."""
    idle = (hertz == 0.0) & (tolls.serving >= 0)
    if problem.pinned_to.size:
        idle &= problem.pinned_to < 0
    return np.where(idle, tolls.serving, serving)


def assigned(problem: Problem, tolls: Tolls, solution: Solution) -> tuple[Users, Array]:
    """Return the best whole bands at these paths.

    The utility is concave in the sums of the slots: where no slot gains by its slope less its tolls, nothing better is
    left. A slot whose slope promised more than it keeps is tried at a smaller one.
    """
    table = _Assignments(problem, tolls, solution)
    for _ in range(SWEEPS):
        gained = [table.improve(n) for n in range(problem.n_slots)]
        if problem.mu == 0.0 or not any(gained):
            break
    return table.serving, table.hertz


class _Assignments:
    """Who serves whom with its whole band: serving, hertz, given_kbps (K, N), improved slot by slot."""

    def __init__(self, problem: Problem, tolls: Tolls, solution: Solution) -> None:
        self._problem, self._tolls = problem, tolls
        self._rates = _whole_band_kbps(problem, solution.paths_m)
        self.hertz = solution.bandwidth_hz.copy()
        self.serving = settled(problem, tolls, solution.serving, self.hertz)
        users, slots = np.arange(problem.n_users)[:, None], np.arange(problem.n_slots)
        whole = self._rates[self.serving, users, slots] / problem.bandwidth_hz[self.serving]
        self._given = whole * self.hertz
        self._worth = self._utility(self._given) - self._toll(self.serving, self.hertz)

    def improve(self, n: int) -> bool:
        """Assign slot n anew if that gains more than it costs; whether it did."""
        slopes = rate_weights(self._problem, self._given)[:, n]
        slope = float((slopes / self._problem.weight).max()) * self._problem.weight
        for share in OVERTAKING if self._problem.mu < 0.0 else (1.0,):
            row, band = _slot(self._problem, self._tolls, self._rates[:, :, n], slope * share, n)
            serving, hertz, given = self.serving.copy(), self.hertz.copy(), self._given.copy()
            serving[:, n], hertz[:, n] = row, band
            given[:, n] = np.where(band > 0.0, self._rates[row, np.arange(len(row)), n], 0.0)
            worth = self._utility(given) - self._toll(serving, hertz)
            if worth > self._worth + 1e-12 * abs(self._worth):
                self.serving, self.hertz, self._given, self._worth = serving, hertz, given, worth
                return True
        return False

    def _utility(self, given_kbps: Array) -> float:
        return self._problem.utility_kbps(given_kbps)

    def _toll(self, serving: Users, hertz: Array) -> float:
        return self._tolls.per_user * float(self._tolls.changed(serving, hertz).sum())


def _slot(problem: Problem, tolls: Tolls, rates: Array, slopes: Array, n: int) -> tuple[Users, Array]:
    """Return server and band of every user in one slot.

    rates: (U, K) kbit/s of whole bands, 0 where not allowed; slopes: (K,), what a kbit/s is worth to each.
    """
    users = np.arange(problem.n_users)
    before = tolls.serving[:, n]
    uavs = np.arange(problem.n_uavs)[:, None]
    worth = slopes * rates - tolls.per_user * ((before >= 0) & (uavs != before))
    worth = np.where(rates > 0.0, np.maximum(worth, 0.0), 0.0)
    row = np.where(before >= 0, before, rates.argmax(axis=0))
    if problem.pinned_to.size:
        row = np.where(problem.pinned_to[:, n] >= 0, problem.pinned_to[:, n], row)
    band = np.zeros(len(users))
    for u, k in zip(*linear_sum_assignment(worth, maximize=True), strict=True):
        if worth[u, k] > 0.0:
            row[k], band[k] = u, problem.bandwidth_hz[u]
    return row.astype(np.intp), band


def _whole_band_kbps(problem: Problem, paths_m: Array) -> Array:
    """Return what each UAV's whole band gives each user, 0 where pins or its end forbid it: (U, K, N)."""
    rates: Array = problem.bandwidth_hz[:, None, None] / 1e3 * spectral_efficiency(problem, paths_m)
    if problem.pinned_to.size:
        uavs = np.arange(problem.n_uavs)[:, None, None]
        rates = np.where((problem.pinned_to < 0) | (problem.pinned_to == uavs), rates, 0.0)
    return rates * problem.there if problem.absent.size else rates
