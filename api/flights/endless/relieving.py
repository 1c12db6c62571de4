"""One relief: what its replan is given, from where vehicles are now, and what is remembered of it."""

from __future__ import annotations

import asyncio
from typing import Any

from skyfolio.api.flights.endless.pool import Crossing, Pool
from skyfolio.api.flights.endless.sortie import nearest_m, who_is_over
from skyfolio.api.flights.flight import Flight
from skyfolio.planner import Plan, ReplanError, Uav
from skyfolio.planner.rota.relief import Relief, relief_pins


async def relief_of(pool: Pool, flight: Flight, previous: Plan, request: dict[str, Any], reliever: str) -> Relief:
    """Return changes and pins of the relief by a vehicle that hovers above its pad.

    request: arguments of `planner.replan` without them. Raises ReplanError where no way is found, and PinError where
    energy does not last.
    """
    at_slot = request["at_slot"]
    if pool.members[reliever].state != "outbound":
        raise ReplanError(f"relief: {reliever!r} is {pool.members[reliever].state}")
    relieved, station = pool.relieved_by(reliever, previous, at_slot)
    if relieved in request["failed"]:
        relieved = None
    uav = _in_the_air(pool.uavs[reliever], flight)
    over = who_is_over(uav.start_m, reliever, flight)
    if over is not None:
        raise ReplanError(f"relief: {over!r} is too close to {reliever!r}")
    horizon = flight.horizon
    made = await asyncio.to_thread(
        relief_pins,
        previous,
        at_slot=at_slot,
        horizon=previous.scenario.slots if horizon is None else horizon.slots_from(at_slot),
        reliever=uav,
        relieved=relieved,
        station_m=station.place_m if relieved is None else None,
        pad_m=None if relieved is None else pool.uavs[relieved].start_m,
        failed=request["failed"],
        positions_m=request["positions_m"],
        used_wh=request["used_wh"],
    )
    _require_clear_of_strays(flight, previous, made, at_slot)
    return made


def _require_clear_of_strays(flight: Flight, previous: Plan, relief: Relief, at_slot: int) -> None:
    """Raise ReplanError if who crosses comes too close to a vehicle that is in the air and in no plan.

    It climbs, hovers or descends above its pad: one that hovers is next, one that descends will soon be down.
    """
    scenario, least_m = previous.scenario, previous.scenario.min_separation_m
    planned = {uav.id for uav in scenario.uavs if previous.first_slot + scenario.last_slot(uav) >= at_slot}
    paths_m = {uav: [*path] for uav, path in relief.pins.paths_m.items()}
    for stray, at_m in flight.positions_m().items():
        if stray in planned or stray in paths_m or stray in flight.lost or flight.roster.is_down(stray):
            continue  # who is lost is a ghost, and kept clear of as such
        for uav, path_m in paths_m.items():
            if nearest_m(at_m, path_m) < least_m:
                raise ReplanError(f"relief: {uav!r} would come too close to {stray!r}, which is above its pad")


def cross(pool: Pool, plan_id: str, reliever: str, relief: Relief) -> None:
    """Remember who is under way in a plan that is about to be flown, and until when."""
    leaves = relief.changes.leaves_at
    crossing = Crossing(
        plan_id=plan_id,
        station=pool.members[reliever].station or "",
        reliever=reliever,
        relieved=next(iter(leaves), None),
        hand_over_at=relief.hand_over_at,
        on_station_at=relief.on_station_at,
        home_at=relief.home_at,
    )
    pool.crossings = [*(one for one in pool.crossings if one.reliever != reliever), crossing]


def _in_the_air(uav: Uav, flight: Flight) -> Uav:
    """Return a vehicle of the pool as it hovers now, with what it has used of its battery."""
    at_m, telemetry = flight.positions_m().get(uav.id), flight.telemetry(uav.id)
    if at_m is None:
        raise ReplanError(f"positions_m: {uav.id!r} does not know where it is")
    battery = uav.battery
    if battery is not None:
        charge = 1.0 if telemetry is None or telemetry.battery is None else telemetry.battery
        battery = battery.model_copy(update={"used_wh": round(battery.usable_wh * (1.0 - charge), 3)})
    return uav.model_copy(update={"start_m": at_m, "home_m": uav.start_m, "battery": battery})
