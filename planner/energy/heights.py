"""How high above home UAVs hover at their starts: what their energy is reckoned with until a plan has altitudes.

A plan's altitudes cost what they are higher on top of that, or less where they are lower (`account.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from skyfolio.planner.altitudes import LimitedFleet, LimitedUav, clearance_of, limits_of, plans_altitudes
from skyfolio.planner.parts import Point

ROUNDING_M = 1e-6
"""Plans keep their altitudes this much above the ground that they ask for."""


class HomeHeight(NamedTuple):
    """height_m: above home, at the start; ground_m: altitude of the ground at home, in the datum of a plan's altitudes.

    With terrain that is mean sea level, otherwise home itself.
    """

    height_m: float
    ground_m: float = 0.0


class LandingUav(LimitedUav, Protocol):
    """What is needed of a UAV."""

    @property
    def start_m(self) -> Point:
        """Where it begins."""

    @property
    def home_m(self) -> Point | None:
        """Where it lands, if that is not its start."""


def home_heights(scenario: LimitedFleet, uavs: Sequence[LandingUav]) -> list[HomeHeight]:
    """Return the heights at which these UAVs can stay at their starts for as long as they like.

    One that flies already stays there no higher than it is, or than ground and its way home ask for.
    """
    if plans_altitudes(scenario):
        return list(_over_ground(scenario, uavs))
    return [HomeHeight(scenario.altitude_m if uav.altitude_m is None else uav.altitude_m) for uav in uavs]


def _over_ground(scenario: LimitedFleet, uavs: Sequence[LandingUav]) -> Iterator[HomeHeight]:
    terrain, clearance_m = scenario.terrain, clearance_of(scenario)
    for uav in uavs:
        start, home = np.array([[uav.start_m], [uav.home_m or uav.start_m]], dtype=float)
        ground = under = homeward = 0.0
        if terrain is not None:
            (under,), (ground,) = terrain.height_m(start).tolist(), terrain.height_m(home).tolist()
            (homeward,) = terrain.highest_on_segments(start, home).tolist()
        least = max(under + limits_of(scenario, uav).low_m, homeward + clearance_m) + ROUNDING_M
        flies_at = least if uav.start_altitude_m is None else max(least, uav.start_altitude_m)
        yield HomeHeight(flies_at - ground, ground)
