"""What `Plan.to_arrays` returns."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array

NOBODY = -1
Table = Literal["users", "uavs"]


class PlanArrays(NamedTuple):
    """A plan of U UAVs, K users and N slots. Slots count from the plan's own `first_slot`.

    uav_ids, user_ids: (U,), (K,) in the order of the scenario. begins_s: (N,) seconds since slot 0 of the operation.
    paths_m: (U, N, 2) metres east/north of the origin when each slot begins. altitudes_m: (U, N) metres, as in the
    plan: above home, or above mean sea level over terrain. serving: (K, N) index of the UAV that serves each user, -1
    for none. bandwidth_hz, rates_bps: (K, N).
    """

    uav_ids: tuple[str, ...]
    user_ids: tuple[str, ...]
    begins_s: Array
    paths_m: Array
    altitudes_m: Array
    serving: NDArray[np.intp]
    bandwidth_hz: Array
    rates_bps: Array
