"""A plan as arrays and as tables, for analysis: what is keyed by ids in `Plan`, by index here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from skyfolio.planner.plan_arrays import NOBODY, PlanArrays, Table
from skyfolio.planner.plans import Plan

if TYPE_CHECKING:
    import pandas as pd


def arrays_of(plan: Plan) -> PlanArrays:
    """Return the arrays of a plan; they are copies."""
    scenario = plan.scenario
    uavs, users = scenario.uav_ids, scenario.user_ids
    index = {uav: number for number, uav in enumerate(uavs)} | {"": NOBODY}
    level = [[scenario.altitude_m] * scenario.slots for _ in uavs]
    heights = level if plan.altitudes_m is None else [plan.altitudes_m[uav] for uav in uavs]
    return PlanArrays(
        uav_ids=uavs,
        user_ids=users,
        begins_s=np.arange(plan.first_slot, plan.first_slot + scenario.slots, dtype=np.float64)
        * scenario.slot_duration_s,
        paths_m=np.array([plan.trajectories_m[uav] for uav in uavs], dtype=float),
        altitudes_m=np.array(heights, dtype=float),
        serving=np.array([[index[uav] for uav in plan.association[user]] for user in users], dtype=np.intp),
        bandwidth_hz=np.array([plan.bandwidth_hz[user] for user in users], dtype=float),
        rates_bps=np.array([plan.user_rates_bps[user] for user in users], dtype=float),
    )


def frame_of(plan: Plan, table: Table) -> pd.DataFrame:
    """Return a table with a row for each slot and user, or each slot and UAV. Raises ImportError without pandas."""
    try:
        import pandas as pd  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ImportError("plan.to_frame needs pandas: pip install 'skyfolio[frames]'") from error
    arrays = arrays_of(plan)
    ids = arrays.user_ids if table == "users" else arrays.uav_ids
    slots = np.arange(len(arrays.begins_s))
    columns: dict[str, Any] = {
        "slot": np.repeat(plan.first_slot + slots, len(ids)),
        "begins_s": np.repeat(arrays.begins_s, len(ids)),
    }
    if table == "users":
        names = np.array([*arrays.uav_ids, ""], dtype=object)
        columns |= {
            "user_id": list(ids) * len(slots),
            "uav_id": names[arrays.serving].T.ravel(),
            "bandwidth_hz": arrays.bandwidth_hz.T.ravel(),
            "rate_bps": arrays.rates_bps.T.ravel(),
        }
    else:
        columns |= {
            "uav_id": list(ids) * len(slots),
            "east_m": arrays.paths_m[:, :, 0].T.ravel(),
            "north_m": arrays.paths_m[:, :, 1].T.ravel(),
            "altitude_m": arrays.altitudes_m.T.ravel(),
        }
    return pd.DataFrame(columns)
