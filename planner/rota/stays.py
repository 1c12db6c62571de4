"""How long a vehicle can stay at a station and still come home with its reserve, from the power model of plans."""

from __future__ import annotations

from math import dist, floor

import numpy as np

from skyfolio.planner.energy.air import Air
from skyfolio.planner.rota.shifts import Sortie
from skyfolio.planner.scenario import Point, Rotors, Scenario, Uav

LONGEST_S = 1e6
"""How long a vehicle without a battery stays: as long as anybody may ask for."""
DETOUR = 1.1
"""Ways out and back may be so much longer than the straight one: around others, or waiting for them."""


def sortie_of(
    scenario: Scenario, uav: Uav, station_m: Point, *, detour: float = DETOUR, dearer: float = 1.0
) -> Sortie | None:
    """Return what a flight from the pad to a station takes; None where it cannot be flown.

    uav: on its pad, which is `start_m`, with a full battery. Energy is that proven for plans: the worst wind within the
    gust, and a reserve that is kept. detour: how much longer than straight ways are reckoned. dearer: how many times as
    much as the model says is reckoned with, where vehicles were found to use more.
    """
    grounded = uav if uav.battery is None else _with_used(uav, None)
    air = scenario.air_for([grounded])
    rotors, height_m = uav.rotors or Rotors(), _height_m(scenario, grounded)
    out, back = _flown(scenario, uav, air, uav.start_m, station_m), _flown(scenario, uav, air, station_m, uav.start_m)
    if out is None or back is None:
        return None
    (out_s, out_wh), (back_s, back_wh) = out, back
    out_s, out_wh, back_s, back_wh = (detour * number for number in (out_s, out_wh, back_s, back_wh))
    stay_s = LONGEST_S
    if air is not None and uav.battery is not None:
        flown_wh = float((air.before_wh + air.landing_wh)[0]) + out_wh + back_wh
        stay_s = _slots(air, float(air.budget_wh[0]) / dearer - flown_wh) * scenario.slot_duration_s
    if stay_s <= 0.0:
        return None
    return Sortie(
        out_s=height_m / rotors.climb_mps + out_s, stay_s=stay_s, back_s=back_s + height_m / rotors.descend_mps
    )


def stay_left_s(
    scenario: Scenario,
    uav: Uav,
    station_m: Point,
    used_wh: float,
    here_m: Point | None = None,
    *,
    detour: float = DETOUR,
    dearer: float = 1.0,
) -> float:
    """Return how much longer a vehicle in the air can stay at a station, seconds; at least 0.

    uav: `start_m` is its pad. used_wh: by now. here_m: where it is, if it has yet to fly to the station.
    dearer: as for `sortie_of`; what is used by now is known, and not reckoned.
    """
    if uav.battery is None:
        return LONGEST_S
    flying = _with_used(uav, used_wh)
    air = scenario.air_for([flying])
    assert air is not None  # noqa: S101 - there is a battery
    out = (0.0, 0.0) if here_m is None else _flown(scenario, uav, air, here_m, station_m)
    back = _flown(scenario, uav, air, station_m, uav.home_m or uav.start_m)
    if out is None or back is None:
        return 0.0
    flown_wh = float(air.landing_wh[0]) + detour * (out[1] + back[1])
    left_wh = float((air.budget_wh - air.before_wh)[0]) / dearer - flown_wh
    return max(0, _slots(air, left_wh)) * scenario.slot_duration_s


def _with_used(uav: Uav, used_wh: float | None) -> Uav:
    assert uav.battery is not None  # noqa: S101 - the caller has looked
    return uav.model_copy(update={"battery": uav.battery.model_copy(update={"used_wh": used_wh})})


def _height_m(scenario: Scenario, uav: Uav) -> float:
    air = scenario.air_for([uav])
    return scenario.altitude_of(uav) if air is None else float(air.height_m[0])


def _slots(air: Air, left_wh: float) -> int:
    """Return how many slots of hovering so much energy lasts."""
    return floor(left_wh / float(air.hover_wh()[0])) if np.isfinite(left_wh) else 0


def _flown(scenario: Scenario, uav: Uav, air: Air | None, here_m: Point, there_m: Point) -> tuple[float, float] | None:
    """Return seconds and proven Wh of the straight way; None where wind or speed do not allow it."""
    away_m = dist(here_m, there_m)
    if away_m == 0.0:
        return 0.0, 0.0
    course = np.subtract(there_m, here_m) / away_m
    step_m = uav.max_speed_mps * scenario.slot_duration_s
    if air is not None:
        step_m = float(air.longest_m(course[None])[0])
    if step_m <= 0.0:
        return None
    slots = away_m / step_m
    spent_wh = 0.0 if air is None else float(air.spent_wh((course * step_m)[None, None], proven=True)[0, 0])
    return slots * scenario.slot_duration_s, slots * spent_wh
