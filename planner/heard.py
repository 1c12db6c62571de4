"""How loud UAVs of a scenario are at its users, by the formulas of its channel: for places that are not optimised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import Places, RadioChannel
from skyfolio.planner.scenario import Scenario

FARTHEST_M2 = 1e14
"""Beyond that distance over ground, squared, nothing changes any more: a UAV that is nowhere is infinitely far away."""


def reference_snr(scenario: Scenario) -> Array:
    """Return `p_u rho / sigma^2` of each UAV: (U,) m^2; divided by a squared distance it is an SNR (eq. 1)."""
    power_w = np.array([uav.transmit_power_w for uav in scenario.uavs])
    noise_w = scenario.channel.noise_w(np.array([uav.bandwidth_hz for uav in scenario.uavs]))
    snr: Array = power_w * scenario.channel.reference_gain / noise_w
    return snr


def factors(
    channel: RadioChannel, over2: Array, heights_m: Array, edge: Array | None = None, *, places_m: Places
) -> Array | float:
    """Return by what SNRs differ from `reference_snr` over squared distances: 1 for the letter's channel.

    over2: squared distances over ground, users' spreads in them, m^2; heights_m: of UAVs over users; edge: of hills
    (`ground.hidden`), None where they do not count; places_m: of users and UAVs; of shapes that broadcast.
    """
    if channel.is_inverse_square and edge is None:
        return 1.0
    away_m, heights_m = np.broadcast_arrays(np.sqrt(np.minimum(over2, FARTHEST_M2)), heights_m)
    return channel.factor(away_m, heights_m, edge, places_m)


def on_air_of(scenario: Scenario) -> NDArray[np.bool_]:
    """Return whether the base station of each UAV sends in each slot: it flies, and is not silent; (U, N)."""
    slots = np.arange(scenario.slots)
    begins = np.array([uav.on_air_from_slot or 0 for uav in scenario.uavs])
    ends = np.array([scenario.last_slot(uav) + 1 for uav in scenario.uavs])
    silent = [scenario.slots if uav.off_air_from_slot is None else uav.off_air_from_slot for uav in scenario.uavs]
    sends: NDArray[np.bool_] = (slots >= begins[:, None]) & (slots < np.minimum(ends, silent)[:, None])
    return sends
