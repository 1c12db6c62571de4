"""One vehicle of a pool leaves its pad while others fly: it climbs and hovers above it, until a relief takes it on.

It is prepared as whole fleets are (`flights.take_off`): facts, preflight audit, geofence, rally points, and a mission
on board, which hovers over the pad and returns.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from itertools import pairwise
from math import dist
from typing import Any

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.take_off import FlightError, TakeOff
from skyfolio.mavlink_bridge import BridgeError
from skyfolio.mavlink_bridge.plane import segment_distances_m
from skyfolio.planner import Plan, Uav, User
from skyfolio.planner.geometry import Point
from skyfolio.planner.plans import Summary

CLIMB_LIMIT_S = 60.0
"""Wall seconds within which a vehicle must be up."""
PATIENCE_S = 10.0
"""Wall seconds within which a vehicle must be armable: it was ready, and there may be another one."""
PREPARED_S = 15.0
"""Wall seconds within which a vehicle must have reported what it is and taken its mission, as it does within two."""
HOVER_SLOTS = 4
CLEAR_SLOTS = 12
"""For so many slots the air above a pad must be free before a vehicle climbs there."""


async def leave_pad(uav: Uav, flight: Flight, fleet: Fleet, clock: FleetClock) -> None:
    """Prepare a vehicle, arm it, and let it climb. Raises BridgeError with what it refused."""
    system = {uav.id: flight.systems[uav.id]}
    take_off = TakeOff(hovering(uav, flight), system, fleet, clock, flight.guidance, patience_s=PATIENCE_S)
    try:
        await take_off.watched(_within(PREPARED_S, take_off.upload()))
        await take_off.watched(take_off.launch(CLIMB_LIMIT_S))
    except BridgeError:
        await take_off.stand_down()
        raise


async def _within(seconds: float, work: Coroutine[Any, Any, float]) -> None:
    """Do some work. Raises FlightError if it takes longer than so many wall seconds."""
    try:
        async with asyncio.timeout(seconds):
            await work
    except TimeoutError:
        raise FlightError(f"it was not prepared within {seconds:g} s") from None


def hovering(uav: Uav, flight: Flight) -> Plan:
    """Return a plan in which the vehicle hovers over its pad for some slots from now on."""
    slots = HOVER_SLOTS
    scenario = flight.plan.scenario.with_changes(
        uavs=(uav,), users=(User(id="user-1", position_m=uav.start_m),), slots=slots
    )
    return Plan(
        id=f"pad-of-{uav.id}",
        method="by hand",
        first_slot=int(flight.now_s() // flight.slot_s),
        scenario=scenario,
        trajectories_m={uav.id: [uav.start_m] * slots},
        association={"user-1": [uav.id] * slots},
        bandwidth_hz={"user-1": [uav.bandwidth_hz] * slots},
        user_rates_bps={"user-1": [0.0] * slots},
        summary=Summary.steady(),
    )


def who_is_over(pad_m: Point, uav: str, flight: Flight) -> str | None:
    """Return which UAV comes too close to the air above a pad in the next slots, or is there now, or None."""
    plan, least_m = flight.plan, flight.first_plan.scenario.min_separation_m
    begin = max(int(flight.now_s() // flight.slot_s) - plan.first_slot, 0)
    for other, at_m in flight.positions_m().items():
        if other == uav or other in flight.lost or flight.roster.is_down(other):
            continue  # who is lost is a ghost, and kept clear of as such
        path = plan.trajectories_m.get(other, [])[begin : begin + CLEAR_SLOTS]
        if nearest_m(pad_m, [at_m, *path]) < least_m:
            return other
    return None


def nearest_m(place_m: Point, path_m: list[Point]) -> float:
    """Return how close a path comes to a place, metres."""
    legs = list(pairwise(path_m))
    if not legs:
        return dist(place_m, path_m[0])
    return float(segment_distances_m([(place_m, place_m)] * len(legs), legs).min())
