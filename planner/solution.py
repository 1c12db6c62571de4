"""What an optimiser returns, before ids and measures are attached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.plans import Iteration


@dataclass(frozen=True)
class Solution:
    """A solution as arrays.

    paths_m: (U, N, 2) metres east/north. serving: (K, N) UAV index. bandwidth_hz: (K, N) Hz from that UAV.
    altitudes_m: (U, N), where altitudes are planned (`ground`).
    """

    paths_m: Array
    serving: NDArray[np.intp]
    bandwidth_hz: Array
    history: list[Iteration]
    altitudes_m: Array | None = None


Observer: TypeAlias = Callable[[Iteration, Callable[[], Solution]], None]
"""Told of each iteration that counts, with what gives the solution that it reached, then or later."""


def ignore(iteration: Iteration, reached: Callable[[], Solution]) -> None:
    """Ignore every iteration: the default observer."""
