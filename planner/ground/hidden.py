"""Hills between UAVs and users: how far they reach into each line of sight.

The ground is looked at where the straight line crosses lines of the terrain's grid, on which all ridges of a bilinear
ground lie; users hold their receivers 1.5 m above it. What it costs is the channel's to say
(`RadioChannel.hidden_gain`).
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.terrain import Terrain

RECEIVER_M = 1.5
AT_ONCE = 5_000
"""So many lines are looked at together, which bounds the memory."""
CLEAR = -1e9
"""Of a line on which nothing can stand."""


def edges_of(scenario: Scenario, user_m: Array, paths_m: Array, heights_m: Array) -> Array | None:
    """Return the edges of all links, (U, K, N); None where hills do not count.

    user_m: (K, N or 1, 2) and paths_m: (U, N, 2), metres east/north; heights_m: (U, K, N), of UAVs over users.
    """
    if scenario.terrain is None or not scenario.channel.counts_hills:
        return None
    return edges(scenario.terrain, user_m, paths_m, heights_m)


def edges(terrain: Terrain, user_m: Array, paths_m: Array, heights_m: Array) -> Array:
    """Return the greatest `h sqrt(2 (1 / d1 + 1 / d2))` on the way from each user to each UAV: (U, K, N), m^(1/2).

    h is by how much the ground is above the line (below 0: clear of it), d1 and d2 the distances from there to the two
    ends, metres: over the root of the wavelength it is `v` of ITU-R P.526-15, eq. (26). Arguments as for `edges_of`.
    """
    pairs = zip(paths_m, heights_m, strict=True)
    return np.stack([edges_of_lines(terrain, user_m, path[None], height) for path, height in pairs])


def edges_of_lines(terrain: Terrain, user_m: Array, uav_m: Array, height_m: Array) -> Array:
    """Return the edges of lines of any shape, as `edges` has them: user_m, uav_m: (..., 2) metres, height_m: (...)."""
    shape = height_m.shape
    users, uavs = (np.broadcast_to(places, (*shape, 2)).reshape(-1, 2) for places in (user_m, uav_m))
    foot = np.broadcast_to(terrain.height_m(user_m), shape).reshape(-1)
    parts = max(1, len(users) // AT_ONCE)
    pieces = zip(*(np.array_split(one, parts) for one in (users, uavs, foot, height_m.reshape(-1))), strict=True)
    return np.concatenate([_on_lines(terrain, *piece) for piece in pieces]).reshape(shape)


def _on_lines(terrain: Terrain, user_m: Array, uav_m: Array, foot_m: Array, height_m: Array) -> Array:
    """Return the edges of L lines, from users on ground as high as `foot_m` to UAVs `height_m` above that: (L,)."""
    shares = terrain.crossings(user_m, uav_m)
    way = uav_m - user_m
    away_m = np.maximum(np.linalg.norm(way, axis=1), 1e-3)[:, None]
    ground_m = terrain.height_m(user_m[:, None] + shares[..., None] * way[:, None])
    above = ground_m - (foot_m + RECEIVER_M)[:, None] - shares * (height_m - RECEIVER_M)[:, None]
    within = (shares > 0.0) & (shares < 1.0)
    split = np.where(within, shares * (1.0 - shares), 0.25)
    edge = np.where(within, above * np.sqrt(2.0 / (away_m * split)), CLEAR)
    return np.asarray(edge.max(axis=1, initial=CLEAR))
