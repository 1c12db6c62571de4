"""From where the survivors are into a new plan: where they will be, and whether they get there safely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import hypot

import numpy as np

from api.flight import Flight
from api.rates import Point
from planner import Plan, ReplanError, closest_approach

SPEED_TOLERANCE = 1.25
"""A first leg may ask for this share of the maximum speed before it is called out of reach: it begins in mid-slot."""


def expected_position(plan: Plan, uav_id: str, live_m: Point, now_s: float, at_slot: int) -> Point:
    """Where a UAV that follows `plan` will be when slot `at_slot` begins, in metres east/north.

    It flies from where it is now toward the points of the slots between, at most at its maximum speed.
    """
    scenario = plan.scenario
    speed = next(uav.max_speed_mps for uav in scenario.uavs if uav.id == uav_id)
    budget = max(at_slot * scenario.slot_duration_s - now_s, 0.0) * speed
    first = int(now_s // scenario.slot_duration_s) + 1 - plan.first_slot
    path: Sequence[Point] = plan.trajectories_m[uav_id][max(first, 0) : at_slot - plan.first_slot + 1]
    here = live_m
    for point in path:
        step = hypot(point[0] - here[0], point[1] - here[1])
        if step > budget:
            share = budget / step
            return here[0] + share * (point[0] - here[0]), here[1] + share * (point[1] - here[1])
        here, budget = point, budget - step
    return here


def scheduled_at(plan: Plan, uav_id: str, now_s: float) -> Point:
    """Where the plan has a UAV `now_s` fleet seconds after slot 0 of the operation began, metres east/north."""
    path = plan.trajectories_m[uav_id]
    slots = max(now_s / plan.scenario.slot_duration_s - plan.first_slot, 0.0)
    begin = min(int(slots), len(path) - 1)
    (e0, n0), (e1, n1) = path[begin], path[min(begin + 1, len(path) - 1)]
    share = min(slots - begin, 1.0)
    return e0 + share * (e1 - e0), n0 + share * (n1 - n0)


def begun_at(plan: Plan, uav_id: str, live_m: Point) -> Plan:
    """The plan with this UAV's first point where it really is, so that its first leg is timed from there."""
    path = [live_m, *plan.trajectories_m[uav_id][1:]]
    return plan.model_copy(update={"trajectories_m": {**plan.trajectories_m, uav_id: path}})


def require_separated(plan: Plan, live: dict[str, Point]) -> None:
    """Refuse a transition in which two survivors come closer than `D_min` on their first legs."""
    legs = {
        uav: [live[uav], plan.trajectories_m[uav][min(1, plan.scenario.slots - 1)]] for uav in plan.scenario.uav_ids
    }
    for a, b in combinations(legs, 2):
        apart = closest_approach(np.array([legs[a], legs[b]]))
        if apart < plan.scenario.min_separation_m:
            raise ReplanError(f"transition: {a!r} and {b!r} would come within {apart:.1f} m on the way to the new plan")


def require_in_reach(plan: Plan, live: Mapping[str, Point], left_s: float) -> None:
    """Refuse a plan whose first point a survivor cannot reach in the `left_s` fleet seconds that its first leg has.

    Raises ReplanError naming the UAV.
    """
    for uav in plan.scenario.uavs:
        first = plan.trajectories_m[uav.id][min(1, plan.scenario.slots - 1)]
        here = live[uav.id]
        far = hypot(first[0] - here[0], first[1] - here[1])
        if far > uav.max_speed_mps * SPEED_TOLERANCE * left_s + plan.scenario.min_separation_m:
            raise ReplanError(f"transition: {uav.id!r} is {far:.1f} m from its first point with {left_s:.1f} s to go")


def achieved(flight: Flight, at_slot: int) -> dict[str, list[float]]:
    """Rates of every slot before `at_slot`: as reported, and as last seen for slots that are still to come."""
    table = {}
    for user, row in flight.reported_rates_bps().items():
        filled: list[float] = []
        for rate in row[:at_slot]:
            filled.append(rate if rate is not None else (filled[-1] if filled else 0.0))
        table[user] = filled
    return table
