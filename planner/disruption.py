"""What a replan changes of the plan that it replaces, and what that is priced; `little_change.py` chooses by it.

The price counts users and metres alike in kbit/s, on the scale of the utility, which is a mean over slots: one
`weight_kbps` for each user that another UAV serves throughout, and for each `METRES_PER_USER` that UAVs are off their
old paths throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.changes import ReplanError
from skyfolio.planner.plans import Disruption, Plan
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.solution import Solution

Ints = NDArray[np.intp]
METRES_PER_USER = 100.0
"""So many metres off the old paths, summed over the UAVs, are priced like one user with another server."""


@dataclass(frozen=True, kw_only=True)
class Former:
    """The rest of the plan that a replan replaces, in the order of the new scenario, and the price of changing it.

    paths_m: (U, N, 2) metres, NaN for UAVs that it did not have, once they have left, and beyond its end; serving:
    (K, N), -1 where the UAV that served is gone, the user is new or it had no such slot; served: (K, N), whether the
    user had bandwidth. weight_kbps: as in the module's docstring.
    """

    paths_m: Array
    serving: Ints
    served: NDArray[np.bool_]
    weight_kbps: float = 0.0


def former_of(previous: Plan, scenario: Scenario, at_slot: int, kept: set[str], weight_kbps: float) -> Former:
    """Return what is left of `previous` from `at_slot` on for the new `scenario`; kept: its UAVs that fly on.

    Raises ReplanError for a weight that is no price.
    """
    if not (np.isfinite(weight_kbps) and weight_kbps >= 0.0):
        raise ReplanError(f"disruption_weight: {weight_kbps} must be a finite number of kbit/s, at least 0")
    begin, slots = at_slot - previous.first_slot, np.arange(scenario.slots)
    both = min(scenario.slots, previous.scenario.slots - begin)
    paths_m = np.full((len(scenario.uavs), scenario.slots, 2), np.nan)
    serving = np.full((len(scenario.users), scenario.slots), -1, dtype=np.intp)
    served = np.zeros(serving.shape, dtype=bool)
    number = {uav: u for u, uav in enumerate(scenario.uav_ids) if uav in kept}
    for uav, u in number.items():
        paths_m[u, :both] = previous.trajectories_m[uav][begin : begin + both]
    for k, user in enumerate(scenario.user_ids):
        if user in previous.association:
            serving[k, :both] = [number.get(uav, -1) for uav in previous.association[user][begin : begin + both]]
            served[k, :both] = np.array(previous.bandwidth_hz[user][begin : begin + both]) > 0.0
    last = np.array([scenario.last_slot(uav) for uav in scenario.uavs])
    there = slots <= last[:, None]
    serving = np.where(slots <= last[serving], serving, -1)
    old_m = np.where(there[:, :, None], paths_m, np.nan)
    return Former(paths_m=old_m, serving=serving, served=served, weight_kbps=weight_kbps)


def disruption_of(former: Former, solution: Solution) -> Disruption:
    """Return what a solution changes of the former plan, and the price of that."""
    concerned = (former.serving >= 0) & (former.served | (solution.bandwidth_hz > 0.0))
    changed = concerned & (solution.serving != former.serving)
    apart_m = np.linalg.norm(solution.paths_m - former.paths_m, axis=2)
    slots = apart_m.shape[1]
    made = Disruption(
        user_slots_changed=int(changed.sum()),
        users_changed=int(changed.any(axis=1).sum()),
        path_changed_m=float(np.nansum(apart_m)) / slots,
        weight_kbps=former.weight_kbps,
        price_bps=0.0,
    )
    return made.model_copy(update={"price_bps": former.weight_kbps * 1e3 * amount_of(made, slots)})


def amount_of(made: Disruption, slots: int) -> float:
    """Return what the weight is multiplied with: users that change, and metres in their measure, slot by slot."""
    return made.user_slots_changed / slots + made.path_changed_m / METRES_PER_USER
