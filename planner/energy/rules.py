"""What a scenario must keep in wind and with batteries: who can hold its place, reach its end, and come home."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import ROUNDING_WH, account_of, idle_paths_m
from skyfolio.planner.energy.air import Air

_FARTHER_M = 1e-6
"""A position this little farther away than a UAV can fly through the wind is in reach: rounding of many steps."""


class Stay(NamedTuple):
    """How long a UAV can stay and come home with its reserve: `slots`; for all that are asked it `lacks_wh`."""

    uav: int
    slots: int
    lacks_wh: float


def stays(air: Air, start_m: Array, end_m: Array, last_slots: Sequence[int]) -> Iterator[Stay]:
    """Yield each UAV that could not stay at its start, or fly straight to its end, for all slots and still come home.

    start_m, end_m: (U, 2), the latter NaN where there is none. last_slots: (U,), the last slot in which each flies.
    """
    flying = np.asarray(last_slots, dtype=np.intp) + 1
    margin = account_of(air, idle_paths_m(start_m, end_m, flying, int(flying.max())), flying).margin_wh
    for u in np.flatnonzero(margin.min(axis=1) < -ROUNDING_WH).tolist():
        row = margin[u, : flying[u]]
        yield Stay(u, int(np.argmax(row < -ROUNDING_WH)), float(-row.min()))


def require_flyable(ids: Sequence[str], air: Air, start_m: Array, end_m: Array, last_slots: Sequence[int]) -> None:
    """Raise ValueError, naming field and rule, for a UAV that cannot hover in the wind, reach its end or come home."""
    blows = float(np.linalg.norm(air.wind_mps))
    for u, still in enumerate(air.still_mps):
        if still < blows:
            raise ValueError(
                f"uavs.{u}.max_airspeed_mps: '{ids[u]}' flies {air.airspeed_mps[u]:g} m/s through the air, but holding "
                f"its place in a wind of {blows:.4g} m/s with gusts of {air.gust_mps:g} m/s takes more than their sum"
            )
    _require_reachable(ids, air, start_m, end_m, last_slots)
    for stay in stays(air, start_m, end_m, last_slots):
        raise ValueError(_would_not_come_home(ids[stay.uav], stay, bool(np.isnan(end_m[stay.uav, 0]))))


def _require_reachable(ids: Sequence[str], air: Air, start_m: Array, end_m: Array, last_slots: Sequence[int]) -> None:
    way = np.nan_to_num(end_m - start_m)
    away = np.linalg.norm(way, axis=1)
    reach = air.longest_m(way[:, None])[:, 0] * np.asarray(last_slots)
    for u in np.flatnonzero(away > reach + _FARTHER_M).tolist():
        raise ValueError(
            f"uavs.{u}.end_m: '{ids[u]}' is {away[u]:.6g} m from its end, but through this wind it can fly only "
            f"{reach[u]:.6g} m there until its last slot"
        )


def _would_not_come_home(uav: str, stay: Stay, stays_at_start: bool) -> str:
    how = "even if it stayed at its start" if stays_at_start else "even if it flew straight to its end"
    until = (
        f"it can stay for {stay.slots} slots (leaves_at_slot: {stay.slots})" if stay.slots else "it cannot stay at all"
    )
    return (
        f"uavs.{{index}}.battery: '{uav}' would not come home with its reserve after slot {stay.slots}, {how}: "
        f"until its last slot it lacks {stay.lacks_wh:.3g} Wh; {until}"
    ).format(index=stay.uav)
