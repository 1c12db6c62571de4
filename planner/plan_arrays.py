"""A plan as arrays and as tables, for analysis: what is keyed by ids in `Plan`, by index here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import Point
from skyfolio.planner.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

NOBODY = -1
Table = Literal["users", "uavs"]


class PlanArrays(NamedTuple):
    """A plan of U UAVs, K users and N slots. Slots count from the plan's own `first_slot`.

    uav_ids, user_ids: (U,), (K,) in the order of the scenario. begins_s: (N,) seconds since slot 0 of the operation.
    paths_m: (U, N, 2) metres east/north of the origin when each slot begins. altitudes_m: (U, N) metres, as in the
    plan: above home, or above mean sea level over terrain. serving: (K, N) index of the UAV that serves each user, -1
    for none. bandwidth_hz, rates_bps: (K, N).
    """

    uav_ids: tuple[str, ...]
    user_ids: tuple[str, ...]
    begins_s: Array
    paths_m: Array
    altitudes_m: Array
    serving: NDArray[np.intp]
    bandwidth_hz: Array
    rates_bps: Array


class Planned(Protocol):
    """What of a `Plan` is made into arrays."""

    @property
    def scenario(self) -> Scenario:
        """Return the scenario."""
        ...

    @property
    def first_slot(self) -> int:
        """Return the first slot."""
        ...

    @property
    def trajectories_m(self) -> Mapping[str, Sequence[Point]]:
        """Return paths by UAV."""
        ...

    @property
    def altitudes_m(self) -> Mapping[str, Sequence[float]] | None:
        """Return altitudes by UAV, if planned."""
        ...

    @property
    def association(self) -> Mapping[str, Sequence[str]]:
        """Return serving UAVs by user."""
        ...

    @property
    def bandwidth_hz(self) -> Mapping[str, Sequence[float]]:
        """Return bandwidth by user."""
        ...

    @property
    def user_rates_bps(self) -> Mapping[str, Sequence[float]]:
        """Return rates by user."""
        ...


def arrays_of(plan: Planned) -> PlanArrays:
    """Return the arrays of a plan; they are copies."""
    scenario = plan.scenario
    uavs, users = scenario.uav_ids, scenario.user_ids
    index = {uav: number for number, uav in enumerate(uavs)} | {"": NOBODY}
    level = [[scenario.altitude_m] * scenario.slots for _ in uavs]
    heights = level if plan.altitudes_m is None else [plan.altitudes_m[uav] for uav in uavs]
    slots = np.arange(plan.first_slot, plan.first_slot + scenario.slots, dtype=np.float64)
    return PlanArrays(
        uav_ids=uavs,
        user_ids=users,
        begins_s=slots * scenario.slot_duration_s,
        paths_m=np.array([plan.trajectories_m[uav] for uav in uavs], dtype=float),
        altitudes_m=np.array(heights, dtype=float),
        serving=np.array([[index[uav] for uav in plan.association[user]] for user in users], dtype=np.intp),
        bandwidth_hz=np.array([plan.bandwidth_hz[user] for user in users], dtype=float),
        rates_bps=np.array([plan.user_rates_bps[user] for user in users], dtype=float),
    )


def frame_of(plan: Planned, table: Table) -> pd.DataFrame:
    """Return a table with a row for each slot and user, or each slot and UAV. Raises ImportError without pandas."""
    try:
        import pandas as pd  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ImportError("plan.to_frame needs pandas: pip install pandas") from error
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
