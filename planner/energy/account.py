"""The energy of paths, slot by slot: what is expected to be used, and what is proven to be left after coming home."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.air import Air

ROUNDING_WH = 1e-9
"""A margin this little below 0 is 0: what adding up the slots is off by."""


class Account(NamedTuple):
    """At the end of each slot, (U, N) Wh; a UAV that has left keeps what its last slot ended with.

    used_wh: expected to be used since the battery was full. margin_wh: proven to be left above the reserve if the UAV
    goes home then and lands; infinite without a battery.
    """

    used_wh: Array
    margin_wh: Array


def account_of(air: Air, paths_m: Array, n_flying: NDArray[np.intp], altitudes_m: Array | None = None) -> Account:
    """Return the energy of paths (U, N, 2), metres at which slots begin; in its last slot a UAV stays where it is.

    altitudes_m: (U, N), likewise; without them every UAV keeps its `height_m` above home. A climb costs what it lifts
    on top of the power of flying, a descent saves nothing.
    """
    last = n_flying[:, None] - 1
    ends_at = np.minimum(np.arange(paths_m.shape[1])[None] + 1, last)
    ended_m = np.take_along_axis(paths_m, ends_at[..., None], axis=1)
    flown = np.arange(paths_m.shape[1])[None] <= last
    moves_m = np.where(flown[..., None], ended_m - paths_m, 0.0)
    expected = np.cumsum(air.spent_wh(moves_m, proven=False) * flown, axis=1)
    proven = np.cumsum(air.spent_wh(moves_m, proven=True) * flown, axis=1)
    before, expected_before = air.before_wh[:, None], air.expected_before_wh[:, None]
    ended_at_m = None
    if altitudes_m is not None:
        ended_at_m = np.take_along_axis(altitudes_m, ends_at, axis=1)
        climbed = np.cumsum(np.maximum(ended_at_m - altitudes_m, 0.0) * flown, axis=1) * air.per_m.climb_wh[:, None]
        higher = air.higher_m(altitudes_m[:, :1])
        before = before + air.per_m.before_wh[:, None] * higher
        expected_before = expected_before + air.per_m.expected_before_wh[:, None] * higher
        expected, proven = expected + climbed, proven + climbed
    left = air.budget_wh[:, None] - before - proven
    return Account(expected_before + expected, left - air.home_wh(ended_m, ended_at_m))


def idle_paths_m(start_m: Array, end_m: Array, n_flying: NDArray[np.intp], n_slots: int) -> Array:
    """Return the paths that ask nothing of a plan: staying at the start, or straight to the end: (U, N, 2) metres."""
    last = np.maximum(n_flying - 1, 1)[:, None]
    share = np.minimum(np.arange(n_slots)[None] / last, 1.0)[..., None]
    target = np.where(np.isnan(end_m), start_m, end_m)
    straight: Array = start_m[:, None] + share * (target - start_m)[:, None]
    return straight
