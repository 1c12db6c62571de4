"""Links between UAVs at altitudes and users on ground of any height.

The optimisers know one height for each UAV. At given paths and altitudes a problem with other gains has exactly the
rates of the true one there: each `snr_gain` is multiplied by the squared distance that the optimisers see over the true
one, and by the true factor of the channel over the one that they see. Near these paths it is a good model too, so paths
can be climbed on from there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.ground.ground import Ground, ground_of
from skyfolio.planner.ground.hidden import edges
from skyfolio.planner.heard import factors
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import Problem


def seen_aloft(problem: Problem, ground: Ground, paths_m: Array, altitudes_m: Array) -> Problem:
    """Return the problem whose rates at these paths (U, N, 2) are those at these altitudes (U, N), metres."""
    over2: Array = (paths_m[:, None, :, 0] - problem.user_m[None, :, :, 0]) ** 2  # in place: tables are large
    over2 += (paths_m[:, None, :, 1] - problem.user_m[None, :, :, 1]) ** 2
    over2 += problem.spread_m2
    gain: Array = over2 + problem.altitude_m[:, None, None] ** 2
    heights_m = heights_over(altitudes_m, ground.user_ground_m)
    places_m = problem.user_m[None], paths_m[:, None]
    if ground.has_hills:
        edge = edges(ground.terrain, problem.user_m, paths_m, heights_m)
        gain *= factors(ground.channel, over2, heights_m, edge, places_m=places_m)
    elif problem.bends is not None:
        gain *= factors(ground.channel, over2, heights_m, places_m=places_m)
    if problem.bends is not None:
        gain /= problem.bends.at(over2)
    if problem.excess is not None:
        gain /= problem.excess.on_paths(paths_m)
    over2 += heights_m**2
    gain /= over2
    gain *= problem.snr_gain
    return replace(problem, snr_gain=gain)


def heights_over(altitudes_m: Array, user_ground_m: Array) -> Array:
    """Return the heights of UAVs (U, N) over users' ground (K, N or 1): (U, K, N) metres."""
    heights: Array = altitudes_m[:, None, :] - user_ground_m[None]
    return heights


def planned_heights(plan: Plan) -> Array:
    """Return the heights of a plan's UAVs over its users: (U, K, N) metres."""
    scenario, ground = plan.scenario, ground_of(plan.scenario)
    shape = len(scenario.uavs), len(scenario.users), scenario.slots
    if ground is None or plan.altitudes_m is None:
        level = np.array([scenario.altitude_of(uav) for uav in scenario.uavs], dtype=float)
        return np.broadcast_to(level[:, None, None], shape)
    altitudes_m = np.array([plan.altitudes_m[uav] for uav in scenario.uav_ids])
    return heights_over(altitudes_m, ground.user_ground_m)
