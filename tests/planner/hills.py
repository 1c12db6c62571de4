"""Small scenarios with a hill, for tests of plans over ground."""

from __future__ import annotations

from typing import Any

import numpy as np

from skyfolio.planner.examples import ZURICH
from skyfolio.planner.scenario import Scenario, Uav, User
from skyfolio.planner.terrain import Terrain


def hill(height_m: float = 120.0, base_m: float = 400.0) -> Terrain:
    """A hill at (250, 250) over flat land, on a grid of 25 m from (-50, -50) to (550, 550)."""
    places = np.arange(-50.0, 551.0, 25.0)
    east, north = np.meshgrid(places, places)
    heights = base_m + height_m * np.exp(-((east - 250.0) ** 2 + (north - 250.0) ** 2) / (2 * 70.0**2))
    return Terrain(south_west_m=(-50.0, -50.0), spacing_m=25.0, heights_m=tuple(map(tuple, heights.round(2).tolist())))


def over_the_hill(**changes: Any) -> Scenario:
    """Two UAVs west and south of the hill, and users on all sides of it."""
    fields: dict[str, Any] = {
        "origin": ZURICH,
        "area_m": ((0.0, 0.0), (500.0, 500.0)),
        "slots": 12,
        "slot_duration_s": 5.0,
        "altitude_m": 40.0,
        "min_separation_m": 4.0,
        "uavs": (
            Uav(id="west", start_m=(60.0, 250.0), max_speed_mps=8.0),
            Uav(id="south", start_m=(250.0, 60.0), max_speed_mps=8.0),
        ),
        "users": tuple(
            User(id=f"user-{number}", position_m=place)
            for number, place in enumerate([(440.0, 250.0), (250.0, 440.0), (250.0, 250.0), (400.0, 400.0)])
        ),
        "terrain": hill(),
    }
    return Scenario(**{**fields, **changes})
