"""The rates that users get when the fleet is at its actual positions rather than the planned ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import expected_gains, fading_gains
from skyfolio.planner.ground.links import planned_heights2
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.sinr import mean_efficiency
from skyfolio.planner.tracks import demands_bps, tracks_of


def delivered_rates_bps(
    plan: Plan, slots: NDArray[np.intp], positions_m: Array, transmitting: NDArray[np.bool_]
) -> Array:
    """Return the rates of eqs. (3)-(4) by the plan's association and bandwidth, at the given positions: (S, K) bit/s.

    UAVs are at the plan's altitudes.

    S samples; slots: (S,) index on the plan's own grid (0 is its first slot). positions_m: (S, U, 2) metres east/north
    of the origin, in the plan's UAV order. transmitting: (S, U): a UAV that is off serves no user and does not
    interfere. No user takes more than it asks for. Raises ValueError when the shapes do not agree or a slot lies
    outside the plan.
    """
    scenario = plan.scenario
    n_samples, n_uavs = len(slots), len(scenario.uavs)
    if positions_m.shape != (n_samples, n_uavs, 2) or transmitting.shape != (n_samples, n_uavs):
        raise ValueError(
            f"positions_m {positions_m.shape} and transmitting {transmitting.shape} must be (S, U, 2), (S, U)"
        )
    if n_samples == 0:
        return np.zeros((0, len(scenario.users)))
    if not 0 <= slots.min() <= slots.max() < scenario.slots:
        raise ValueError(f"slots: {slots.min()}..{slots.max()} must lie in 0..{scenario.slots - 1}")
    asked, column = np.unique(slots, return_inverse=True)  # what depends on the slot is made for these alone
    user_m, spread_m2 = (table[:, slots if table.shape[1] > 1 else [0]] for table in tracks_of(scenario))
    power_w = np.array([uav.transmit_power_w for uav in scenario.uavs])
    channel = scenario.channel
    noise_w = 10 ** (channel.noise_dbm / 10 - 3)
    fading = _fading(plan, asked)[:, :, column]
    apart = positions_m[:, :, None, :] - user_m.transpose(1, 0, 2)[:, None]  # (S, U, K, 2)
    heights2 = planned_heights2(plan)[:, :, slots]  # (U, K, S)
    distance2 = np.einsum("sukd,sukd->suk", apart, apart) + np.moveaxis(heights2, 2, 0) + spread_m2.T[:, None]
    on = power_w[:, None] * 10 ** (channel.reference_gain_db / 10) / noise_w * transmitting[:, :, None]
    snr = np.moveaxis(on / distance2 * np.moveaxis(fading, 2, 0), 0, 2)  # (U, K, S)
    efficiency = np.moveaxis(mean_efficiency(snr, snr, _draws(scenario)), 2, 1)  # (U, S, K)
    index = {uav: u for u, uav in enumerate(scenario.uav_ids)}
    links = [plan.association[user] for user in scenario.user_ids]
    bands = [plan.bandwidth_hz[user] for user in scenario.user_ids]
    serving = np.array([[index[row[n]] for row in links] for n in asked], dtype=np.intp)[column]  # (S, K)
    bandwidth = np.array([[row[n] for row in bands] for n in asked])[column]
    chosen = np.take_along_axis(efficiency, serving[None], axis=0)[0]
    rates: Array = np.minimum(bandwidth * chosen, demands_bps(scenario))
    return rates


def _draws(scenario: Scenario) -> Array:
    """Return the draws over which the plan's rates are averaged, (D, U, K), empty without any."""
    if scenario.channel.fading != "expected":
        return np.zeros((0, 0, 0))
    return expected_gains(scenario.channel, scenario.uav_ids, scenario.user_ids)


def _fading(plan: Plan, slots: NDArray[np.intp]) -> Array:
    """Return |h|^2 of eq. (2) in some slots of the plan's own grid, in rising order: (U, K, len(slots))."""
    scenario = plan.scenario
    first, n_slots = int(slots[0]), int(slots[-1] - slots[0]) + 1
    gains = fading_gains(scenario.channel, scenario.uav_ids, scenario.user_ids, plan.first_slot + first, n_slots)
    chosen: Array = gains[:, :, slots - first]
    return chosen
