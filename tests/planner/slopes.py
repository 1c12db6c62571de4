"""The gradient of the kernels beside finite differences of their rates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, Links, arena_of, links_of
from skyfolio.planner.fast.climb import climb
from skyfolio.planner.fast.rates import gradient, link_rates
from skyfolio.planner.problem import Problem

Place = tuple[int, int, int]
"""Slot, axis and UAV."""


def _rates_and_slope(arena: Arena, path: Array, links: Links, rate: Array, weight: Array, slope: Array) -> None:
    link_rates(arena, path, links, rate)
    gradient(arena, path, links, weight, slope)


rates_and_slope = njit(_rates_and_slope)


def slopes(problem: Problem, spread_m: float, step_m: float, *places: Place) -> Iterator[tuple[float, float]]:
    """Yield the slope of a weighted sum of rates by the kernels, and by central differences.

    The paths hover, but for `spread_m` at random; step_m: either way.
    """
    arena = arena_of(problem)
    rng = np.random.default_rng(0)
    path = np.ascontiguousarray((problem.hover() + rng.normal(0, spread_m, problem.hover().shape)).transpose(1, 2, 0))
    links = links_of(arena)
    climb(arena, path, links, 0, 1e-6)
    weight = rng.uniform(0.5, 2, links.khz.shape)
    rate, slope = np.zeros(links.khz.shape), np.empty(path.shape)
    rates_and_slope(arena, path, links, rate, weight, slope)

    def total(at: Array) -> float:
        rates_and_slope(arena, at, links, rate, weight, np.empty(path.shape))
        return float(sum((weight[n, :used] * rate[n, :used]).sum() for n, used in enumerate(links.used)))

    for place in places:
        step = np.zeros(path.shape)
        step[place] = step_m
        yield slope[place], (total(path + step) - total(path - step)) / (2 * step_m)
