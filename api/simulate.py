"""`skyfolio simulate`: the software fleet as a process of its own."""

from __future__ import annotations

import asyncio
import json
import signal
import sys

from rich.console import Console

from mavlink_bridge import east_north_to_geodetic
from planner import EXAMPLES, Scenario
from sim import Event, Fleet, ScaledClock, VehicleSpec, grid_of, serve

WATCH_S = 0.2


def specs_at_starts(scenario: Scenario, autopilot: str = "px4") -> list[VehicleSpec]:
    """One vehicle on the ground at each UAV's start; system ids 1, 2, ... in the scenario's order."""
    specs = []
    for system_id, uav in enumerate(scenario.uavs, start=1):
        lat_deg, lon_deg = east_north_to_geodetic(scenario.origin, *uav.start_m)
        specs.append(VehicleSpec(system_id, lat_deg, lon_deg, autopilot=autopilot))
    return specs


async def run_fleet(
    vehicles: int,
    speedup: float,
    endpoint: str,
    scenario: Scenario | None,
    duration_s: float | None,
    *,
    autopilot: str,
    as_json: bool,
) -> None:
    """Fly until SIGINT or SIGTERM (or for `duration_s` fleet seconds), printing what truly happens, line by line."""
    origin = EXAMPLES["paper"]().origin
    if scenario:
        specs = specs_at_starts(scenario, autopilot)
    else:
        specs = grid_of(vehicles, origin.lat_deg, origin.lon_deg, autopilot=autopilot)
    fleet = Fleet(specs, clock=ScaledClock(speedup), endpoint=endpoint)
    until = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, until.set)
    console = Console()
    if not as_json:
        console.print(f"{len(specs)} vehicles send to {endpoint} at {speedup:g} times real time; Ctrl-C ends them")
    printer = asyncio.create_task(_print_events(fleet, console, as_json=as_json))
    try:
        await serve(fleet, until=until, for_s=duration_s)
    finally:
        printer.cancel()


async def _print_events(fleet: Fleet, console: Console, *, as_json: bool) -> None:
    shown = 0
    while True:
        for event in fleet.truth.events[shown:]:
            shown += 1
            _print_event(event, console, as_json=as_json)
        await asyncio.sleep(WATCH_S)


def _print_event(event: Event, console: Console, *, as_json: bool) -> None:
    detail = {name: value for name, value in event.detail.items() if name != "items"}
    if as_json:
        row = {"t_s": round(event.t_s, 3), "system_id": event.system_id, "kind": event.kind, **detail}
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()
    else:
        words = " ".join(f"{name}={value}" for name, value in detail.items())
        console.print(f"{event.t_s:9.2f} s  vehicle {event.system_id}  {event.kind} {words}", highlight=False)
