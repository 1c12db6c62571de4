"""Random scenarios of any size, the same for the same seed: for benchmarks, sweeps and tests."""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np

from skyfolio.planner.examples import ZURICH
from skyfolio.planner.scenario import Channel, Scenario, Uav, User, Utility

SPACING_M = 250.0
"""Between neighbouring starts, as in the letter's simulation."""


def scattered(n_uavs: int, n_users: int, n_slots: int, *, seed: int, utility: Utility | None = None) -> Scenario:
    """Return UAVs on a square grid and users uniformly in the area; the rest is as in `examples.paper`."""
    columns = ceil(sqrt(n_uavs))
    rows = ceil(n_uavs / columns)
    width, height = columns * SPACING_M, rows * SPACING_M
    rng = np.random.default_rng(seed)
    positions = np.round(rng.uniform((0.0, 0.0), (width, height), size=(n_users, 2)), 1)
    return Scenario(
        origin=ZURICH,
        area_m=((0.0, 0.0), (width, height)),
        slots=n_slots,
        slot_duration_s=5.0,
        altitude_m=60.0,
        min_separation_m=4.0,
        uavs=tuple(
            Uav(id=f"uav-{u + 1}", start_m=((u % columns + 0.5) * SPACING_M, (u // columns + 0.5) * SPACING_M))
            for u in range(n_uavs)
        ),
        users=tuple(User(id=f"user-{k + 1}", position_m=(float(e), float(n))) for k, (e, n) in enumerate(positions)),
        channel=Channel(noise_dbm=-55.0, seed=seed),
        utility=utility or Utility(),
    )
