"""The rates that users get when the fleet is at its actual positions rather than the planned ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import expected_gains, fading_gains
from skyfolio.planner.ground.hidden import edges_of
from skyfolio.planner.ground.links import planned_heights
from skyfolio.planner.heard import factors, on_air_of, reference_snr
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.sinr import mean_efficiency
from skyfolio.planner.tracks import demands_bps, tracks_of


def delivered_rates_bps(
    plan: Plan, slots: NDArray[np.intp], positions_m: Array, transmitting: NDArray[np.bool_]
) -> Array:
    """Return the rates of eqs. (3)-(4) by the plan's association and bandwidth, at the given positions: (S, K) bit/s.

    See `Delivery.rates_bps`, for which one `Delivery` serves where the same plan is asked for again and again.
    """
    return Delivery(plan).rates_bps(slots, positions_m, transmitting)


class Delivery:
    """The rates of one plan at positions other than planned; what does not depend on them is made once."""

    def __init__(self, plan: Plan) -> None:
        self._plan, scenario = plan, plan.scenario
        self._n_slots, self._n_uavs, self._n_users = scenario.slots, len(scenario.uavs), len(scenario.users)
        self._user_m, self._spread_m2 = tracks_of(scenario)
        self._snr_at_1_m = reference_snr(scenario)[:, None]
        self._heights_m = planned_heights(plan)
        self._draws = _draws(scenario)
        self._demands_bps = demands_bps(scenario)
        self._index = {uav: u for u, uav in enumerate(scenario.uav_ids)}
        self._links = [plan.association[user] for user in scenario.user_ids]
        self._bands = [plan.bandwidth_hz[user] for user in scenario.user_ids]
        self._on_air = on_air_of(scenario)
        self._last: tuple[tuple[int, ...], Array, NDArray[np.intp], Array] | None = None

    def rates_bps(self, slots: NDArray[np.intp], positions_m: Array, transmitting: NDArray[np.bool_]) -> Array:
        """Return the rates of eqs. (3)-(4) by the plan's association and bandwidth: (S, K) bit/s.

        UAVs are at the plan's altitudes.

        S samples; slots: (S,) index on the plan's own grid (0 is its first slot). positions_m: (S, U, 2) metres
        east/north of the origin, in the plan's UAV order. transmitting: (S, U): a UAV that is off serves no user and
        does not interfere. No user takes more than it asks for. Raises ValueError when the shapes do not agree or a
        slot lies outside the plan.
        """
        n_samples = len(slots)
        if positions_m.shape != (n_samples, self._n_uavs, 2) or transmitting.shape != (n_samples, self._n_uavs):
            raise ValueError(
                f"positions_m {positions_m.shape} and transmitting {transmitting.shape} must be (S, U, 2), (S, U)"
            )
        if n_samples == 0:
            return np.zeros((0, self._n_users))
        if not 0 <= slots.min() <= slots.max() < self._n_slots:
            raise ValueError(f"slots: {slots.min()}..{slots.max()} must lie in 0..{self._n_slots - 1}")
        asked, column = np.unique(slots, return_inverse=True)  # what depends on the slot is made for these alone
        fading, serving, bandwidth = self._in_slots(asked)
        user_m, spread_m2 = (
            table[:, slots if table.shape[1] > 1 else [0]] for table in (self._user_m, self._spread_m2)
        )
        places_m = user_m.transpose(1, 0, 2)[:, None], positions_m[:, :, None, :]
        apart = places_m[1] - places_m[0]  # (S, U, K, 2)
        heights_m = self._heights_m[:, :, slots].transpose(2, 0, 1)  # (S, U, K)
        over2 = np.einsum("sukd,sukd->suk", apart, apart)
        distance2 = over2 + heights_m**2 + spread_m2.T[:, None]
        scenario = self._plan.scenario
        edge = edges_of(scenario, user_m, positions_m.swapaxes(0, 1), self._heights_m[:, :, slots])
        edge = None if edge is None else edge.transpose(2, 0, 1)
        bent = factors(scenario.channel, over2 + spread_m2.T[:, None], heights_m, edge, places_m=places_m)
        on = self._snr_at_1_m * (transmitting & self._on_air[:, slots].T)[:, :, None]
        snr = (on / distance2 * bent * fading[:, :, column].transpose(2, 0, 1)).transpose(1, 2, 0)  # (U, K, S)
        efficiency = mean_efficiency(snr, snr, self._draws).transpose(0, 2, 1)  # (U, S, K)
        chosen = np.take_along_axis(efficiency, serving[column][None], axis=0)[0]
        rates: Array = np.minimum(bandwidth[column] * chosen, self._demands_bps)
        return rates

    def _in_slots(self, asked: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp], Array]:
        """Return |h|^2 (U, K, A), who serves whom and on which bandwidth (A, K) in some slots, in rising order."""
        key = tuple(asked.tolist())
        if self._last is None or self._last[0] != key:
            serving = np.array([[self._index[row[n]] for row in self._links] for n in key], dtype=np.intp)
            bandwidth = np.array([[row[n] for row in self._bands] for n in key])
            self._last = key, _fading(self._plan, asked), serving, bandwidth
        return self._last[1:]


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
