"""Where each UAV flies and which users it serves: as planned, and after a loss."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import fading_gains, squared_distances, sum_of_others
from skyfolio.planner.ground.hidden import edges_of
from skyfolio.planner.ground.links import planned_heights
from skyfolio.planner.heard import factors, reference_snr
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.tracks import demands_bps, tracks_of


@dataclass(frozen=True, kw_only=True)
class Flown:
    """An operation as it is flown, on the grid of the plan that is assessed; U UAVs, K users, N slots in its order.

    paths_m: (U, N, 2) metres. serving: (K, N), which UAV serves. bandwidth_hz: (K, N). on: (U, N), whether a UAV is
    there: one that is not serves no user and does not interfere. heights_m: (U, K, N), over users.
    """

    scenario: Scenario
    paths_m: Array
    serving: NDArray[np.intp]
    bandwidth_hz: Array
    on: NDArray[np.bool_]
    heights_m: Array

    def rates_bps(self, gains: Array, errors_m: Array | None = None) -> Array:
        """Return the rates of eqs. (1)-(4) under fading `gains` (U, K, N) and errors (U, N, 2): (K, N) bit/s.

        No user takes more than it asks for.
        """
        scenario = self.scenario
        user_m, spread_m2 = tracks_of(scenario)
        alike = reference_snr(scenario)[:, None] * self.on
        paths_m = self.paths_m if errors_m is None else self.paths_m + errors_m
        over_ground = squared_distances(paths_m, user_m, np.zeros(len(paths_m)), np.zeros(spread_m2.shape))
        edge = edges_of(scenario, user_m, paths_m, self.heights_m)
        places_m = user_m[None], paths_m[:, None]
        bent = factors(scenario.channel, over_ground + spread_m2, self.heights_m, edge, places_m=places_m)
        snr = alike[:, None, :] * gains / (over_ground + self.heights_m**2 + spread_m2) * bent
        at = self.serving[None]
        own = np.take_along_axis(snr, at, axis=0)[0]
        others = np.take_along_axis(sum_of_others(snr), at, axis=0)[0]
        rates = self.bandwidth_hz * np.log1p(own / (1.0 + others)) / np.log(2)
        taken: Array = np.minimum(rates, demands_bps(scenario)[:, None])
        return taken


def flown_as_planned(plan: Plan) -> Flown:
    """Return the plan as it says."""
    scenario = plan.scenario
    index = {uav: u for u, uav in enumerate(scenario.uav_ids)}
    last = np.array([scenario.last_slot(uav) for uav in scenario.uavs])
    return Flown(
        scenario=scenario,
        paths_m=np.array([plan.trajectories_m[uav] for uav in scenario.uav_ids], dtype=float),
        serving=np.array([[index[uav] for uav in plan.association[user]] for user in scenario.user_ids], dtype=np.intp),
        bandwidth_hz=np.array([plan.bandwidth_hz[user] for user in scenario.user_ids], dtype=float),
        on=np.arange(scenario.slots) <= last[:, None],
        heights_m=planned_heights(plan),
    )


def planned_gains(plan: Plan) -> Array:
    """Return |h|^2 for which the plan was made: (U, K, N)."""
    scenario = plan.scenario
    return fading_gains(scenario.channel, scenario.uav_ids, scenario.user_ids, plan.first_slot, scenario.slots)


def without(flown: Flown, lost: Collection[str], from_slot: int) -> Flown:
    """Return the operation without the lost UAVs from a slot of its own grid on; nothing else changes."""
    gone = np.isin(np.array(flown.scenario.uav_ids), list(lost))
    on = flown.on.copy()
    on[gone, from_slot:] = False
    return replace(flown, on=on)


def replanned(flown: Flown, new: Plan, from_slot: int) -> Flown:
    """Return the operation that goes on with a new plan of its survivors, from a slot of its own grid on."""
    row = {uav: u for u, uav in enumerate(flown.scenario.uav_ids)}
    then = flown_as_planned(new)
    mine = np.array([row[uav] for uav in new.scenario.uav_ids], dtype=np.intp)
    paths, serving, bandwidth = flown.paths_m.copy(), flown.serving.copy(), flown.bandwidth_hz.copy()
    heights = flown.heights_m.copy()
    heights[mine, :, from_slot:] = then.heights_m
    paths[mine, from_slot:] = then.paths_m
    serving[:, from_slot:] = mine[then.serving]
    bandwidth[:, from_slot:] = then.bandwidth_hz
    return replace(flown, paths_m=paths, serving=serving, bandwidth_hz=bandwidth, heights_m=heights)
