"""Where the survivors of a flight will be when a new plan begins, how high, and with what left in their batteries."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from skyfolio.api.flights.energy import used_by_slot_wh
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.transition import expected_altitude, expected_position
from skyfolio.planner import Plan


def whereabouts(flight: Flight, previous: Plan, at_slot: int, readmitted: Collection[str] = ()) -> dict[str, Any]:
    """Return `positions_m`, `altitudes_m` and `used_wh` of a replan of `previous` from slot `at_slot` on.

    Survivors follow the plan in force until then, as far as they get from where they are now; `readmitted` UAVs, which
    do not fly it, stay where they are.
    """
    now_s, places_m, heights_m = flight.now_s(), flight.positions_m(), flight.heights_m()
    known = {*flight.plan.trajectories_m, *readmitted} - flight.lost.keys()
    flown = [uav for uav in previous.scenario.uav_ids if uav in known]
    return {
        "positions_m": {
            uav: places_m[uav]
            if uav in readmitted
            else expected_position(flight.plan, uav, places_m[uav], now_s, at_slot)
            for uav in flown
            if uav in places_m
        },
        "altitudes_m": None
        if previous.altitudes_m is None
        else {
            uav: heights_m[uav]
            if uav in readmitted
            else expected_altitude(flight.plan, uav, heights_m[uav], now_s, at_slot)
            for uav in flown
            if uav in heights_m
        },
        "used_wh": used_by_slot_wh(previous, flown, at_slot, now_s, flight.telemetry),
    }
