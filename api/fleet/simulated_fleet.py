"""A simulated fleet inside the service, for drills: real MAVLink on a real socket, in a thread of its own."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Coroutine, Iterable
from dataclasses import replace
from typing import Any, TypeVar

from skyfolio import sim
from skyfolio.api.common.errors import InvalidError
from skyfolio.mavlink_bridge import DEFAULT_AUTOPILOT, east_north_to_geodetic, geodetic_to_east_north
from skyfolio.planner import Scenario
from skyfolio.planner.altitudes import climb_mps, plans_altitudes

Result = TypeVar("Result")
GUST_SPREADS = 3.0
"""The bound on gusts in a scenario, over the spread of simulated gusts on one axis."""
LEAST_ALTITUDE_RADIUS_M, MOST_ALTITUDE_RADIUS_M = 5.0, 200.0
"""NAV_MC_ALT_RAD of simulated PX4 that climb on their way: the most is that of the parameter."""


def specs_at_starts(
    scenario: Scenario,
    autopilot: str = DEFAULT_AUTOPILOT.value,
    booted_s_ago: float = sim.BOOTED_S_AGO,
    battery_mah: float = sim.BATTERY_MAH,
) -> list[sim.VehicleSpec]:
    """Return one vehicle on the ground at each UAV's start; system ids 1, 2, ... in the scenario's order.

    With terrain their homes are at its heights. battery_mah: what a new battery holds. Where plans have altitudes they
    are set up as the preflight audit asks for: a PX4 as delivered would miss waypoints on its climbs.
    """
    specs = []
    for system_id, uav in enumerate(scenario.uavs, start=1):
        lat_deg, lon_deg = east_north_to_geodetic(scenario.origin, *uav.start_m)
        spec = sim.VehicleSpec(
            system_id, lat_deg, lon_deg, autopilot=autopilot, booted_s_ago=booted_s_ago, battery_mah=battery_mah
        )
        if scenario.terrain is not None:
            spec = replace(spec, home_alt_m=scenario.terrain.height_at(*uav.start_m))
        if plans_altitudes(scenario):
            radius_m = max(climb_mps(uav) * scenario.slot_duration_s, LEAST_ALTITUDE_RADIUS_M)
            spec = replace(spec, parameters=(("NAV_MC_ALT_RAD", min(radius_m, MOST_ALTITUDE_RADIUS_M)),))
        specs.append(spec)
    return specs


def hills_of(scenario: Scenario) -> sim.Hills | None:
    """Return the ground of a scenario with terrain, for its simulated fleet."""
    terrain = scenario.terrain
    if terrain is None:
        return None
    return sim.Hills(lambda lat, lon: terrain.height_at(*geodetic_to_east_north(scenario.origin, lat, lon)))


def weather_of(scenario: Scenario, fronts: Iterable[sim.WindFront] = ()) -> sim.Weather | None:
    """Return the wind of a scenario for its simulated fleet; its bound on gusts is three times their spread.

    fronts: how it changes later. None for a scenario without wind, and no fronts.
    """
    wind, later = scenario.wind, tuple(fronts)
    if wind is None:
        return sim.Weather(fronts=later) if later else None
    spread_mps = wind.gust_mps / GUST_SPREADS
    return sim.Weather(wind_east_mps=wind.east_mps, wind_north_mps=wind.north_mps, gust_mps=spread_mps, fronts=later)


def own_endpoint() -> str:
    """Return HOST:PORT of a loopback UDP port that is free now, so that the simulated fleet keeps to itself."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


def fault_of(kind: str, system_id: int, options: dict[str, Any], *, stations: bool = True) -> sim.Fault:
    """Return a fault that is ready to strike. stations: whether base stations of the fleet are joined.

    Raises InvalidError for an unknown kind or option, and for a fault of a base station that serves no user.
    """
    if kind not in sim.FAULTS:
        raise InvalidError(f"fault: {kind!r} must be one of {', '.join(sim.FAULTS)}")
    if kind in sim.RADIO_FAULTS and not stations:
        raise InvalidError(
            f"fault: {kind!r} strikes a base station, and those of the simulated fleet serve no user "
            "(SKYFOLIO_SIMULATE_STATIONS=false)"
        )
    if {"kind", "system_id"} & set(options):
        raise InvalidError("options: the kind and the vehicle are given beside them")
    try:
        return sim.fault_from({"kind": kind, "system_id": system_id, **options})
    except (TypeError, ValueError) as error:
        raise InvalidError(f"options: {error}") from error


class SimulatedFleet:
    """Vehicles at the starts of a scenario, which fly in their own thread from `start` to `stop`.

    stations: whether their base stations are joined to the operations that they fly. field: what happens around them.
    """

    def __init__(
        self,
        scenario: Scenario,
        endpoint: str,
        speedup: float,
        *,
        stations: bool = True,
        field: sim.FieldKnobs | None = None,
    ) -> None:
        field = field or sim.FieldKnobs()
        self.speedup, self.stations = speedup, stations
        self.uav_ids = scenario.uav_ids
        """Which UAV each vehicle is, by system id from 1 on."""
        self.fleet = sim.Fleet(
            specs_at_starts(scenario, battery_mah=field.battery_mah),
            clock=sim.ScaledClock(speedup),
            endpoint=f"udpout://{endpoint}",
            weather=weather_of(scenario, field.fronts),
            hills=hills_of(scenario),
            crew=field.crew,
        )
        for vehicle in self.fleet.vehicles.values():
            if "COM_OBL_RC_ACT" in vehicle.autopilot.parameters:
                vehicle.autopilot.parameters["COM_OBL_RC_ACT"] = 5  # hold: it may be streamed to
        self._loop = asyncio.new_event_loop()
        self._until = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="simulated-fleet", daemon=True)

    def start(self) -> None:
        """Start the thread in which the vehicles fly."""
        self._thread.start()

    def inject(self, fault: sim.Fault) -> None:
        """Let a fault strike now."""
        self._loop.call_soon_threadsafe(self.fleet.inject, fault)

    async def meanwhile(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Do some work in the thread of the vehicles, between two of their steps; return its result."""
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(work, self._loop))

    def stop(self) -> None:
        """End the thread, wherever the vehicles are."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._until.set)
            self._thread.join()

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(sim.serve(self.fleet, until=self._until))
        finally:
            self._loop.close()
