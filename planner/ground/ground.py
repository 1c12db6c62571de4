"""The ground under a scenario, and what its UAVs keep from it, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.altitudes import clearance_of, climb_mps, limits_of, plans_altitudes
from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.terrain import Terrain
from skyfolio.planner.tracks import tracks_of


@dataclass(frozen=True, kw_only=True)
class Ground:
    """U UAVs, K users. Heights in metres above mean sea level; without terrain the ground is level, at 0, and home.

    low_m, high_m: (U,), metres above the highest ground under a leg; high_m is infinite where altitudes are not chosen.
    clearance_m: what ways home keep. climb_m: (U,), metres per slot, up or down. home_m: (U, 2), metres east/north.
    start_m: (U,), the altitude in slot 0, NaN where the UAV climbs there beforehand. user_ground_m: (K, S), the ground
    under users, S as in `Problem.user_m`. n_flying: (U,), in how many slots each flies.
    """

    terrain: Terrain
    channel: RadioChannel
    low_m: Array
    high_m: Array
    clearance_m: float
    climb_m: Array
    home_m: Array
    start_m: Array
    user_ground_m: Array
    n_flying: NDArray[np.intp]

    @property
    def has_hills(self) -> bool:
        """Whether hills between UAVs and users count."""
        return self.channel.counts_hills and bool(np.ptp(self.terrain.grid_m) > 0.0)

    @property
    def chooses(self) -> bool:
        """Whether any altitude is chosen between limits."""
        return bool(np.isfinite(self.high_m).any())

    def of(self, uavs: NDArray[np.intp]) -> Ground:
        """Return the same ground for some UAVs of the fleet; one may be there several times."""
        of_uavs = ("low_m", "high_m", "climb_m", "home_m", "start_m", "n_flying")
        return replace(self, **{name: getattr(self, name)[uavs] for name in of_uavs})


def ground_of(scenario: Scenario) -> Ground | None:
    """Return the ground under this scenario; None where plans have no altitudes."""
    if not plans_altitudes(scenario):
        return None
    terrain = scenario.terrain or Terrain.flat()
    limits = [limits_of(scenario, uav) for uav in scenario.uavs]
    starts = [np.nan if uav.start_altitude_m is None else uav.start_altitude_m for uav in scenario.uavs]
    return Ground(
        terrain=terrain,
        channel=scenario.channel,
        low_m=np.array([limit.low_m for limit in limits]),
        high_m=np.array([np.inf if limit.high_m is None else limit.high_m for limit in limits]),
        clearance_m=clearance_of(scenario),
        climb_m=np.array([climb_mps(uav) for uav in scenario.uavs]) * scenario.slot_duration_s,
        home_m=np.array([uav.home_m or uav.start_m for uav in scenario.uavs], dtype=float),
        start_m=np.array(starts),
        user_ground_m=terrain.height_m(tracks_of(scenario)[0]),
        n_flying=np.array([scenario.last_slot(uav) + 1 for uav in scenario.uavs]),
    )
