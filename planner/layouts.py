"""Random scenarios of any size, the same for the same seed: for benchmarks, sweeps and tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, sqrt
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.gain_map import GainMap
from skyfolio.planner.examples import ZURICH
from skyfolio.planner.geometry import Point
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
    starts = [((u % columns + 0.5) * SPACING_M, (u // columns + 0.5) * SPACING_M) for u in range(n_uavs)]
    return _scenario((width, height), starts, positions, n_slots, Channel(noise_dbm=-55.0, seed=seed), utility)


def laid_out(
    layout: str,
    n_uavs: int,
    n_users: int,
    n_slots: int,
    *,
    seed: int,
    utility: Utility | None = None,
    noise_dbm: float = -60.0,
) -> Scenario:
    """Users as `layout` (a name in `LAYOUTS`) has them, in a square of 500 m x sqrt(U/3); starts on a grid.

    Three UAVs have the letter's area, and each has as much room in a larger fleet. Raises KeyError for another name.
    """
    side = round(500.0 * sqrt(n_uavs / 3), 1)
    positions = np.round(np.clip(LAYOUTS[layout](np.random.default_rng(seed), n_users, n_uavs), 0.0, 1.0) * side, 1)
    columns = ceil(sqrt(n_uavs))
    rows = ceil(n_uavs / columns)
    starts = [((u % columns + 0.5) * side / columns, (u // columns + 0.5) * side / rows) for u in range(n_uavs)]
    return _scenario((side, side), starts, positions, n_slots, Channel(noise_dbm=noise_dbm, seed=seed), utility)


def shadow_map(
    scenario: Scenario,
    *,
    spacing_m: float = 25.0,
    shadowing_db: float = 8.0,
    correlation_m: float = 40.0,
    seed: int = 0,
    **channel: Any,
) -> GainMap:
    """Return a map of gains over a scenario's area with a receiver at each user, at the fleet's altitudes.

    Gains are those of the letter's channel (-20 dB at one metre) with shadows of this standard deviation, drawn for
    each receiver, which are alike over about `correlation_m`. channel: other fields, as `noise_dbm`.
    """
    (west, south), (east, north) = scenario.area_m
    rows, columns = ceil((north - south) / spacing_m) + 1, ceil((east - west) / spacing_m) + 1
    levels = sorted({scenario.altitude_of(uav) for uav in scenario.uavs})
    at_m = np.stack(np.meshgrid(west + np.arange(columns) * spacing_m, south + np.arange(rows) * spacing_m), axis=-1)
    rng, maps = np.random.default_rng(seed), []
    for user in scenario.users:
        over2 = np.square(at_m - user.position_m).sum(axis=-1)
        drawn = gaussian_filter(rng.normal(size=(rows, columns)), correlation_m / spacing_m, mode="wrap")
        shadow_db = shadowing_db * drawn / max(float(drawn.std()), 1e-12)
        maps.append([np.round(-20.0 - 10.0 * np.log10(over2 + level**2) + shadow_db, 2).tolist() for level in levels])
    return GainMap.model_validate(
        {
            "receivers_m": [user.position_m for user in scenario.users],
            "levels_m": levels,
            "south_west_m": (west, south),
            "spacing_m": spacing_m,
            "gains_db": maps,
            **channel,
        }
    )


def _scenario(
    corner_m: Point,
    starts_m: Sequence[Point],
    users_m: Array,
    n_slots: int,
    channel: Channel,
    utility: Utility | None,
) -> Scenario:
    """Return the scenario of these starts and users (K, 2) in the area from (0, 0) to its far corner."""
    return Scenario(
        origin=ZURICH,
        area_m=((0.0, 0.0), corner_m),
        slots=n_slots,
        slot_duration_s=5.0,
        altitude_m=60.0,
        min_separation_m=4.0,
        uavs=tuple(Uav(id=f"uav-{number}", start_m=start) for number, start in enumerate(starts_m, start=1)),
        users=tuple(
            User(id=f"user-{number}", position_m=(float(e), float(n))) for number, (e, n) in enumerate(users_m, start=1)
        ),
        channel=channel,
        utility=utility or Utility(),
    )


def _uniform(rng: np.random.Generator, n_users: int, n_uavs: int) -> Array:  # noqa: ARG001
    """Anywhere."""
    return rng.uniform(size=(n_users, 2))


def _clustered(rng: np.random.Generator, n_users: int, n_uavs: int) -> Array:
    """In groups of about 6 % of the side, one for every two UAVs."""
    centres = rng.uniform(0.1, 0.9, size=(max(2, n_uavs // 2), 2))
    around: Array = centres[rng.integers(len(centres), size=n_users)] + rng.normal(0.0, 0.06, size=(n_users, 2))
    return around


def _stadium(rng: np.random.Generator, n_users: int, n_uavs: int) -> Array:  # noqa: ARG001
    """On the stands around an oval field."""
    angle, radius = rng.uniform(0.0, 2 * np.pi, n_users), rng.uniform(0.25, 0.35, n_users)
    return np.stack([0.5 + radius * np.cos(angle), 0.5 + 0.7 * radius * np.sin(angle)], axis=1)


def _corridor(rng: np.random.Generator, n_users: int, n_uavs: int) -> Array:  # noqa: ARG001
    """Along a winding road from west to east."""
    east = rng.uniform(size=n_users)
    return np.stack([east, 0.5 + 0.15 * np.sin(6.0 * east) + rng.normal(0.0, 0.03, n_users)], axis=1)


def _two_towns(rng: np.random.Generator, n_users: int, n_uavs: int) -> Array:  # noqa: ARG001
    """In two towns with no user between them."""
    centres = np.array([[0.25, 0.3], [0.75, 0.7]])
    around: Array = centres[rng.integers(2, size=n_users)] + rng.normal(0.0, 0.1, size=(n_users, 2))
    return around


LAYOUTS: dict[str, Callable[[np.random.Generator, int, int], Array]] = {
    "uniform": _uniform,
    "clustered": _clustered,
    "stadium": _stadium,
    "corridor": _corridor,
    "two_towns": _two_towns,
}
"""Where users stand, by name: (K, 2), shares of the side; what lies outside [0, 1] is taken at the edge."""
