"""The price of metres off given paths, and its slope, for the ascent: sqrt(metres^2 + blur^2) - blur of each metre."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, kernel


@kernel
def price_of_way(arena: Arena, path: Array) -> float:
    """Return what `path` (N, 2, U) costs for being off the given one, kbit/s of utility; 0 without a price."""
    if not arena.has_price:
        return 0.0
    former, blur2, metres = arena.former, arena.blur_m * arena.blur_m, 0.0
    for n in range(path.shape[0]):
        for u in range(path.shape[2]):
            de, dn = path[n, 0, u] - former[n, 0, u], path[n, 1, u] - former[n, 1, u]
            if not np.isnan(de):
                metres += np.sqrt(de * de + dn * dn + blur2) - arena.blur_m
    return float(arena.per_metre * metres)


@kernel
def lean_back(arena: Arena, path: Array, slope: Array) -> None:
    """Subtract the slope of that price from `slope` (N, 2, U), if there is one; slot 0 is fixed."""
    if not arena.has_price:
        return
    former, blur2 = arena.former, arena.blur_m * arena.blur_m
    for n in range(1, path.shape[0]):
        for u in range(path.shape[2]):
            de, dn = path[n, 0, u] - former[n, 0, u], path[n, 1, u] - former[n, 1, u]
            if not np.isnan(de):
                share = arena.per_metre / np.sqrt(de * de + dn * dn + blur2)
                slope[n, 0, u] -= share * de
                slope[n, 1, u] -= share * dn
