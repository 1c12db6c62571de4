"""The problem as the kernels see it: plain contiguous arrays, slot first.

Shapes: U UAVs, K users, N slots. Positions are (N, 2, U), metres east (row 0) and north (row 1) of the origin, so that
the UAVs of a slot lie side by side. Bandwidth is kHz and rates are kbit/s, because mu is in 1/(kbit/s).
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.excess import Frame
from skyfolio.planner.fast.air import Breeze, breeze_of
from skyfolio.planner.fast.bent import Bend
from skyfolio.planner.fast.jit import entry as entry  # noqa: PLC0414 - kernels get them from here
from skyfolio.planner.fast.jit import inlined as inlined  # noqa: PLC0414 - kernels get them from here
from skyfolio.planner.fast.jit import kernel as kernel  # noqa: PLC0414 - kernels get them from here
from skyfolio.planner.fast.jit import smooth as smooth  # noqa: PLC0414 - kernels get them from here
from skyfolio.planner.problem import Problem
from skyfolio.planner.repair import step_limits_m
from skyfolio.planner.utilities import Expectation, kind_of

Ints: TypeAlias = NDArray[np.int64]
Flag: TypeAlias = bool | np.bool
"""A kernel compiles anew for each literal; `np.bool_(True)` is not one."""

SUM, PER_USER, POOLED = map(int, Expectation)
MARGIN = 1e-8
"""Minimum rates are kept this much (relatively) above what is asked, for rounding."""


def plain(array: NDArray[Any], dtype: type = np.float64) -> NDArray[Any]:
    """Return the array as kernels take it: C-contiguous, writable, of one type; a copy where it is not.

    numba compiles a kernel anew for each layout and for read-only arrays: whatever goes into an `entry` passes here or
    is made new, so that each has one signature, and none is left to compile in flight.
    """
    flags = array.flags
    if flags.c_contiguous and flags.writeable and array.dtype == dtype:
        return array  # as it would come back, in a tenth of the time
    return np.require(array, dtype, ["C", "W"])


class Arena(NamedTuple):
    """What does not change while one problem is solved.

    gain: (N, U), m^2, of a mean channel; fading: (N, U, K), m^2, of a sampled one, else empty; draws: (K, U, S),
    factors of `gain` over which rates are averaged, else empty. low, high: (2,).
    step_m: (U,), `D_max`, less rounding. last: (U,), the last slot in which each UAV flies. end_m: (2, U), NaN where
    free. user_m: (S, 3, K), east, north, and what is added to squared distances from there, m^2; slot n finds its
    own at [n * per_slot], which is 0 where users stay and S is 1. counted: the first slot whose rates count. n_past:
    how many past slots count.
    past_low, past_sum, past_count: (K,), the least past rate of each user, sum exp(mu (rate - least)) of its past, and
    in how many past slots it was there; for `sum` the first entries are the sum rate's.
    discs: (D, 3), east, north, radius. corners: (V, 2) of all no-fly polygons, polygon p at [first[p], first[p + 1]).
    turns: (2, C), where ways around zones may turn; sees: (C, C), which of them see each other;
    left: (U, C), slots from each to the end of each UAV (`routes.py`).
    pinned: (N, 2, U), metres, where UAVs have to be, NaN for those that are free; pinned_to: (N, K), who has to serve
    each user, -1 where that is free; both empty without pins.
    former: (N, 2, U), metres, from where each metre away costs `per_metre` kbit/s of utility, NaN where it is free;
    within some `blur_m` of there it costs less (`priced.py`); empty without a price.
    weight: (K,), as how many users each counts. demand: (K,), kbit/s beyond which a rate is worth nothing.
    absent: (N, K), 1 where a user is not there; empty where all always are. gone: (K,), in how many slots that is.
    bend: by what factor the gain differs from an inverse square, if has_bend. breeze: wind and energy. has_wind: it
    limits steps. has_energy: some UAV might not be able to afford some path.
    """

    gain: Array
    fading: Array
    draws: Array
    user_m: Array
    per_slot: int
    height2: Array
    khz: Array
    start_m: Array
    step_m: Array
    last: Ints
    end_m: Array
    low: Array
    high: Array
    separation_m: float
    discs: Array
    corners: Array
    first: Ints
    kind: int
    mu: float
    counted: int
    n_past: int
    past_low: Array
    past_sum: Array
    past_count: Array
    min_kbps: Array
    turns: Array
    sees: Ints
    left: Ints
    pinned: Array
    pinned_to: Ints
    former: Array
    per_metre: float
    blur_m: float
    weight: Array
    demand: Array
    absent: Ints
    gone: Array
    breeze: Breeze
    bend: Bend
    has_bend: bool
    has_pinned: bool
    has_pinned_to: bool
    has_ends: bool
    has_minimum: bool
    has_price: bool
    has_weights: bool
    has_absent: bool
    has_demand: bool
    has_floors: bool
    has_wind: bool
    has_energy: bool


class Links(NamedTuple):
    """Who serves whom: in slot n the entries [0, used[n]) of (N, W) user, uav, khz; each user at most once.

    floor: (N, W), kbit/s that the link keeps while UAVs move: the minimum rate of its user, or all that it asks for.
    log_weight: (K,), of the last minorant (`shares.py`). W is U for `sum` without minimum rates and demands, else K.
    """

    used: Ints
    user: Ints
    uav: Ints
    khz: Array
    floor: Array
    log_weight: Array


def arena_of(problem: Problem) -> Arena:
    """Return the arrays of `problem` in the kernels' layout. `mu = 0` of any kind is `sum`."""
    mean = is_mean(problem)
    gain = problem.snr_gain[:, 0, :].T
    fading = np.zeros((0, 0, 0)) if mean else problem.snr_gain.transpose(2, 0, 1)
    asked = int(kind_of(problem.kind).expectation)
    kind = asked if problem.mu < 0 else SUM
    past_low, past_sum, past_count = _past(problem, kind)
    breeze = breeze_of(problem)
    return Arena(
        gain=plain(gain),
        fading=plain(fading),
        draws=plain(problem.draws.transpose(2, 1, 0)),
        user_m=plain(np.concatenate([problem.user_m, problem.spread_m2[:, :, None]], axis=2).transpose(1, 2, 0)),
        per_slot=int(problem.user_m.shape[1] > 1),
        height2=plain(problem.altitude_m**2),
        khz=plain(problem.bandwidth_hz / 1e3),
        start_m=plain(problem.start_m.T),
        step_m=plain(step_limits_m(problem)),
        last=plain(np.minimum(problem.n_flying, problem.n_slots) - 1, np.int64),
        end_m=plain(problem.end_m.T),
        low=plain(problem.low_m),
        high=plain(problem.high_m),
        separation_m=float(problem.separation_m),
        discs=plain(problem.discs),
        corners=plain(np.vstack(problem.polygons) if problem.polygons else np.zeros((0, 2))),
        first=np.cumsum([0, *map(len, problem.polygons)], dtype=np.int64),
        kind=kind,
        mu=float(problem.mu),
        counted=int(problem.counted_from),
        n_past=int(problem.past_kbps.shape[1]),
        past_low=plain(past_low),
        past_sum=plain(past_sum),
        past_count=plain(past_count),
        min_kbps=plain(problem.min_kbps * (1.0 + MARGIN)),
        turns=np.zeros((2, 0)),
        sees=np.zeros((0, 0), dtype=np.int64),
        left=np.zeros((problem.n_uavs, 0), dtype=np.int64),
        pinned=plain(problem.pinned_m.transpose(1, 2, 0)),
        pinned_to=plain(problem.pinned_to.T, np.int64),
        former=np.zeros((0, 2, 0)),
        per_metre=0.0,
        blur_m=1.0,
        breeze=breeze,
        bend=bend_of(problem),
        has_bend=problem.bends is not None,
        has_pinned=problem.pinned_m.size > 0,
        has_pinned_to=problem.pinned_to.size > 0,
        has_ends=bool(np.isfinite(problem.end_m).any()),
        has_minimum=bool((problem.min_kbps > 0).any()),
        has_price=False,
        weight=plain(problem.weight),
        absent=plain(problem.absent.T, np.int64),
        gone=plain(problem.absent.T.sum(axis=0) if problem.absent.size else np.zeros(problem.n_users)),
        has_weights=bool((problem.weight != 1.0).any()),
        has_absent=problem.absent.size > 0,
        demand=plain(np.maximum(problem.demand_kbps, problem.min_kbps * (1.0 + MARGIN))),
        has_demand=problem.has_demand,
        has_floors=problem.has_demand or bool((problem.min_kbps > 0).any()),
        has_wind=problem.air is not None and problem.air.has_wind,
        has_energy=bool(np.isfinite(breeze.spare_wh).any()),
    )


def bend_of(problem: Problem) -> Bend:
    """Return the factors of the problem's channel in the kernels' layout."""
    if problem.bends is None:
        none, nobody = np.zeros(0), np.zeros(0, dtype=np.int64)
        square, maps = np.zeros((0, 0)), np.zeros((0, 0, 0, 0))
        return Bend(square, nobody, none, none, none, maps, nobody.reshape(0, 0), np.zeros(2), 0.0)
    bends, excess = problem.bends, problem.excess
    like, like_height2 = bends.fitted
    frame = Frame(0.0, 0.0, 1.0) if excess is None else excess.frame
    return Bend(
        plain(bends.factor),
        plain(bends.row, np.int64),
        plain(1.0 / bends.step_m),
        plain(like[bends.row]),
        plain(like_height2[bends.row]),
        np.zeros((0, 0, 0, 0)) if excess is None else plain(excess.logs),
        np.zeros((0, 0), dtype=np.int64) if excess is None else plain(excess.reads.T, np.int64),
        np.array([frame.west_m, frame.south_m]),
        1.0 / frame.spacing_m,
    )


@kernel
def hide_absent(arena: Arena, n: int, signal: Array) -> None:
    """Set the signals (U, K) of slot n to 0 for users who are not there: no link is made without one."""
    for k in range(signal.shape[1]):
        if arena.absent[n, k] != 0:
            for u in range(signal.shape[0]):
                signal[u, k] = 0.0


@kernel
def is_pinned(arena: Arena, u: int) -> bool:
    """Return whether the path of UAV u is given, of a fleet that `has_pinned`: asked first, since a call takes time."""
    return not np.isnan(arena.pinned[0, 0, u])


def free_uavs(arena: Arena) -> Ints:
    """Return the UAVs whose paths are to be found."""
    given = np.isfinite(arena.pinned[0, 0]) if arena.has_pinned else np.zeros(arena.gain.shape[1], dtype=bool)
    return np.flatnonzero(~given)


def mean_user_m(arena: Arena) -> Array:
    """Return the mean place of each user over the slots: (2, K) metres."""
    return plain(arena.user_m[:, :2].mean(axis=0))


def is_mean(problem: Problem) -> bool:
    """Return whether all users share one row of gains."""
    return problem.snr_gain.strides[1] == 0 or problem.n_users == 1


def _past(problem: Problem, kind: int) -> tuple[Array, Array, Array]:
    """Return the past as (least, sum exp(mu (x - least)), count) of each row; at mu = 0 as (0, sum, count)."""
    past = problem.past_kbps
    if past.shape[1] == 0:
        rows = 1 if kind == SUM else len(past)
        return np.full(rows, np.inf if problem.mu else 0.0), np.zeros(rows), np.zeros(rows)
    rates = np.nansum(problem.weight[:, None] * past, axis=0, keepdims=True) if kind == SUM else past
    there = np.isfinite(rates)
    count = there.sum(axis=1).astype(float)
    if problem.mu == 0.0:
        return np.zeros(len(rates)), rates.sum(axis=1), count
    low = np.where(there, rates, np.inf).min(axis=1, initial=np.inf)
    above = np.where(there, rates - np.where(np.isfinite(low), low, 0.0)[:, None], 0.0)
    return low, (np.exp(problem.mu * above) * there).sum(axis=1), count


def links_of(arena: Arena) -> Links:
    """Empty links of the right size."""
    n_slots, n_uavs = arena.gain.shape
    n_users = arena.user_m.shape[2]
    width = n_uavs if arena.kind == SUM and not arena.has_floors else n_users
    shape = (n_slots, max(1, width))
    return Links(
        used=np.zeros(n_slots, dtype=np.int64),
        user=np.zeros(shape, dtype=np.int64),
        uav=np.zeros(shape, dtype=np.int64),
        khz=np.zeros(shape),
        floor=np.zeros(shape),
        log_weight=np.log(arena.weight),
    )


def copy_of(links: Links) -> Links:
    """Return the same links in tables of their own."""
    return Links(
        links.used.copy(),
        links.user.copy(),
        links.uav.copy(),
        links.khz.copy(),
        links.floor.copy(),
        links.log_weight.copy(),
    )
