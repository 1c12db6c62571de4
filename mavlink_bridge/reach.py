"""Predict where a vehicle will be when its first leg should end, from its speed and the vehicle's model. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist, sqrt

from skyfolio.mavlink_bridge.pace import VehicleModel, fastest_on_leg, way_from_rest_m
from skyfolio.mavlink_bridge.route import Route
from skyfolio.mavlink_bridge.schedule import SAME_PLACE_M, ground_schedule
from skyfolio.planner.geometry import Point

UNDER_WAY_S = 0.3
"""Seconds until an order to start shows as acceleration."""
STRAY_M = 1.0
"""A vehicle may have left its point by this much at the beginning of the slot with which it leaves."""


@dataclass(frozen=True, slots=True)
class Miss:
    """How far behind a vehicle is (metres) when slot `slot` begins, at the end of a first leg of leg_m metres."""

    slot: int
    miss_m: float
    leg_m: float


def first_leg_miss(path_m: Sequence[Point], slot_s: float, model: VehicleModel) -> Miss | None:
    """Return the prediction for the mission compiled from this path, flown from rest; None if it never moves.

    path_m: (n_slots, 2) metres east/north. The leg is flown at the speed the compiler gives it, or as fast as the
    autopilot's own planning lets it fly a leg of that length, and begun with its head start.
    """
    route = Route(path_m, slot_s)
    leaves = next((slot for slot in range(route.last) if route.way_m(slot, slot + 1) >= SAME_PLACE_M), None)
    if leaves is None:
        return None
    schedule = ground_schedule(path_m, slot_s, model)
    leg = schedule.legs[0]
    speed_mps = min(leg.speed_mps, fastest_on_leg(leg.distance_m, model))
    leg_m = dist(path_m[leaves], path_m[leaves + 1])
    ahead_s = head_start_s(path_m, leaves, slot_s, model)
    flown_m = way_from_rest_m(speed_mps, slot_s + ahead_s - UNDER_WAY_S, model.departing())
    return Miss(slot=leaves + 1, miss_m=max(leg_m - flown_m, 0.0), leg_m=leg_m)


def head_start_s(path_m: Sequence[Point], slot: int, slot_s: float, model: VehicleModel) -> float:
    """Return the seconds before slot `slot` begins at which a vehicle at rest should set out; 0 if it needs none.

    With a low jerk limit it hardly moves at first: with 1 m/s^3, a metre in 1.8 s. Setting out so early costs that
    metre, and saves 1.8 s of lateness at the next point, which no speed could make up for.
    """
    if slot + 1 >= len(path_m):
        return 0.0
    leg_m = dist(path_m[slot], path_m[slot + 1])
    if leg_m < SAME_PLACE_M:
        return 0.0
    speed_mps = min(model.max_speed_mps, fastest_on_leg(leg_m, model))
    model = model.departing()
    missing_m = leg_m - way_from_rest_m(speed_mps, slot_s - UNDER_WAY_S, model)
    if missing_m <= 0:
        return 0.0
    by_acceleration_s = sqrt(2 * STRAY_M / model.acceleration_mps2)
    by_jerk_s: float = (6 * STRAY_M / model.jerk_mps3) ** (1 / 3)
    return min(max(by_acceleration_s, by_jerk_s), missing_m / speed_mps)
