"""Wind and energy for the kernels: how far a step may go, and whether a UAV can afford it and still come home.

What a UAV has to spare is what is left above its reserve if it hovers where it is until its last slot is over and goes
home from there, all at its worst within the gust. Hovering on changes nothing of it, so a hold is safe for energy too;
a step that is longer than it can afford is shortened. One with an end position must be able to go home at once from
each slot instead: its ways are judged, not bent. The arithmetic is that of `energy/air.py`, UAV by UAV.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import ROUNDING_WH
from skyfolio.planner.energy.air import Air
from skyfolio.planner.fast.jit import kernel
from skyfolio.planner.problem import Problem

CHORDS = 4
KEPT_WH = 1e-6
"""Never spent, so that rounding leaves a replan something: staying costs nothing of it."""
LITTLE_WH = 1e-5
"""With less to spare a UAV goes no further."""


class Breeze(NamedTuple):
    """Wind and energy as the kernels see it, in metres per slot.

    wind: (2,). step, reach: (U,), the longest way over ground and through the air in a slot, the latter less the gust.
    law: (U, 5), the constants of `Law`. homes: (U, H, 2). each_wh: (U,), what a further slot at rest is counted as: a
    hover, or nothing with an end position. spare_wh: (U,), to spare in slot 0, infinite where no path can use it up.
    most_wh: (U,), what no step takes off it more than.
    """

    wind: Array
    step: Array
    reach: Array
    gust: float
    slot_s: float
    law: Array
    homes: Array
    each_wh: Array
    spare_wh: Array
    most_wh: Array


def breeze_of(problem: Problem) -> Breeze:
    """Return wind and energy of `problem`; empty tables where it has neither."""
    air = problem.air
    if air is None:
        none = np.zeros(0)
        return Breeze(np.zeros(2), none, none, 0.0, 1.0, np.zeros((0, 5)), np.zeros((0, 0, 2)), none, none, none)
    hover = air.hover_wh()
    ending = np.isfinite(problem.end_m[:, 0])
    return Breeze(
        wind=np.ascontiguousarray(air.wind_mps * air.slot_s),
        step=np.ascontiguousarray(problem.step_m),
        reach=np.ascontiguousarray(air.still_mps * air.slot_s),
        gust=float(air.gust_mps * air.slot_s),
        slot_s=float(air.slot_s),
        law=np.ascontiguousarray(np.stack(air.law, axis=1)),
        homes=np.ascontiguousarray(air.homes_m),
        each_wh=np.where(ending, 0.0, hover),
        spare_wh=_spare_wh(problem, air, hover, ending),
        most_wh=air.most_spare_used_wh(1, problem.step_m),
    )


def _spare_wh(problem: Problem, air: Air, hover_wh: Array, ending: Array) -> Array:
    """Return what each UAV has to spare in slot 0, infinite where no path can use it up: (U,) Wh."""
    slots = problem.n_flying
    home = air.home_wh(problem.start_m[:, None])[:, 0]
    spare = air.budget_wh - air.before_wh - home - hover_wh * np.where(ending, 1, slots)
    corners = np.stack(
        [problem.low_m, [problem.low_m[0], problem.high_m[1]], [problem.high_m[0], problem.low_m[1]], problem.high_m]
    )
    extent = np.linalg.norm(corners[None] - air.homes_m[:, :1], axis=-1).max(axis=1)
    most = air.most_spare_used_wh(slots, extent) + np.where(ending, hover_wh * slots, 0.0)
    bent = np.where(spare > -ROUNDING_WH, np.maximum(spare - KEPT_WH, 0.0), spare)
    kept: Array = np.where(spare >= most, np.inf, np.where(ending, spare + ROUNDING_WH / 2, bent))
    return kept


def longest_steps_m(breeze: Breeze, step_m: Array, way_m: Array) -> Array:
    """Return how far each UAV flies in a slot in the direction of ways (2, U, K): (U, K) metres, as `longest`."""
    away = np.hypot(*way_m)
    along = (way_m[0] * breeze.wind[0] + way_m[1] * breeze.wind[1]) / np.where(away > 0.0, away, 1.0)
    across2 = np.maximum((breeze.reach**2)[:, None] - breeze.wind @ breeze.wind + along**2, 0.0)
    farthest: Array = np.minimum(step_m[:, None], np.maximum(along + np.sqrt(across2), 0.0))
    return farthest


@kernel
def longest(breeze: Breeze, u: int, step_m: float, dx: float, dy: float) -> float:
    """Return how far UAV u flies in a slot in the direction (dx, dy), metres; step_m: its `D_max`."""
    away = np.hypot(dx, dy)
    if away == 0.0:
        return step_m
    wx, wy, reach = breeze.wind[0], breeze.wind[1], breeze.reach[u]
    along = (dx * wx + dy * wy) / away
    across2 = max(0.0, reach * reach - wx * wx - wy * wy + along * along)
    return float(min(step_m, max(0.0, along + np.sqrt(across2))))


@kernel
def slot_wh(breeze: Breeze, u: int, dx: float, dy: float) -> float:
    """Return what a slot in which UAV u moves by (dx, dy) metres is proven to cost, Wh."""
    through = np.hypot(dx - breeze.wind[0], dy - breeze.wind[1])
    return float(_worst_w(breeze, u, through) * breeze.slot_s / 3600.0)


@kernel
def _worst_w(breeze: Breeze, u: int, through: float) -> float:
    """Return W that are not exceeded at an airspeed of `through` metres per slot and any within the gust of it."""
    blade, tip, induced, induced_mps, parasite = breeze.law[u]
    most = (through + breeze.gust) / breeze.slot_s
    least = max(through - breeze.gust, 0.0) / breeze.slot_s
    most2, ratio = most * most, least * least / (2.0 * induced_mps * induced_mps)
    power = blade * (1.0 + 3.0 * most2 / (tip * tip)) + parasite * most2 * most
    return float(power + induced * np.sqrt(np.sqrt(1.0 + ratio * ratio) - ratio))


@kernel
def home_wh(breeze: Breeze, u: int, x: float, y: float) -> float:
    """Return what the way from (x, y) to the cheapest landing place is proven to cost, without the landing, Wh."""
    least = np.inf
    for h in range(breeze.homes.shape[1]):
        dx, dy = breeze.homes[u, h, 0] - x, breeze.homes[u, h, 1] - y
        away = np.hypot(dx, dy)
        if away == 0.0:
            return 0.0
        limit = longest(breeze, u, breeze.step[u], dx, dy)
        if limit > 0.0:
            share = limit / away
            least = min(least, slot_wh(breeze, u, dx * share, dy * share) * away / limit)
    return least


@kernel
def left_wh(
    breeze: Breeze, u: int, spare_wh: float, home: float, x: float, y: float, dx: float, dy: float
) -> tuple[float, float]:
    """Return what UAV u has to spare after it has stepped by (dx, dy) from (x, y), and what the way home costs then.

    spare_wh, home: both before the step. Staying changes nothing.
    """
    if dx == 0.0 and dy == 0.0 and breeze.each_wh[u] > 0.0:
        return spare_wh, home
    there = home_wh(breeze, u, x + dx, y + dy)
    return spare_wh - (slot_wh(breeze, u, dx, dy) - breeze.each_wh[u] + there - home), there


@kernel
def affordable_share(
    breeze: Breeze, u: int, spare_wh: float, home: float, x: float, y: float, dx: float, dy: float
) -> float:
    """Return a share of the step (dx, dy) that UAV u can afford, of a UAV that can afford to hover: from 0 to 1.

    What is left falls ever faster along the step, so that the chord between a share that leaves something and one that
    leaves too little nearly always meets 0 at a share that is affordable; only such shares are returned.
    """
    low, left, high, short = 0.0, spare_wh, 1.0, left_wh(breeze, u, spare_wh, home, x, y, dx, dy)[0]
    if short >= 0.0:
        return 1.0
    for _ in range(CHORDS):
        if left < LITTLE_WH or not short > -np.inf:
            return low
        share = low + (high - low) * left / (left - short)
        value = left_wh(breeze, u, spare_wh, home, x, y, share * dx, share * dy)[0]
        if value >= 0.0:
            low, left = share, value
        else:
            high, short = share, value
    return low
