"""`skyfolio serve`: the worker of flights loads while this process imports the rest of the service."""

from __future__ import annotations

import gc
import signal
import sys
from typing import Annotated, Any

import typer

from skyfolio.api.cli.field_options import BatteryMinutes, Crew, Fronts, PacksOfPad, Turnaround
from skyfolio.api.cli.files import Json
from skyfolio.api.cli.lazy import print_error
from skyfolio.api.common import kernels


def serve(
    host: Annotated[str | None, typer.Option(help="Address to bind; by default the loopback address.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="TCP port.")] = None,
    database_url: Annotated[str | None, typer.Option(help="SQLite or PostgreSQL URL, or 'temporary'.")] = None,
    fleet_url: Annotated[str | None, typer.Option(help="Where vehicles are, e.g. udpin://127.0.0.1:14540.")] = None,
    simulate: Annotated[
        str | None, typer.Option(help="Simulate the fleet of this example, or of a scenario in a .json file.")
    ] = None,
    radio_channel: Annotated[
        str | None,
        typer.Option(help="How the true channel of that fleet's users differs: bias_db=-6,shadowing_db=4,seed=1."),
    ] = None,
    crew: Crew = None,
    turnaround_s: Turnaround = None,
    packs: PacksOfPad = None,
    battery_minutes: BatteryMinutes = None,
    front: Fronts = None,
    time_scale: Annotated[float | None, typer.Option(help="Speed-up of a simulated fleet; 1 for real ones.")] = None,
    ui: Annotated[bool, typer.Option("--ui/--no-ui", help="Serve the dashboard at /ui.")] = True,
    as_json: Json = False,
) -> None:
    """Run the service. Settings also come from SKYFOLIO_* environment variables."""
    options = {
        "host": host,
        "port": port,
        "database_url": database_url,
        "fleet_url": fleet_url,
        "simulate": simulate,
        "simulate_channel": radio_channel,
        "simulate_crew": crew,
        "simulate_turnaround_s": turnaround_s,
        "simulate_packs": packs,
        "simulate_battery_minutes": battery_minutes,
        "simulate_fronts": ";".join(front) if front else None,
        "time_scale": time_scale,
    }
    _run({name: value for name, value in options.items() if value is not None}, as_json=as_json, ui=ui)


def _run(settings: dict[str, Any], *, as_json: bool, ui: bool) -> None:
    """Run the service until it is interrupted; SIGTERM ends it with status 0. Raises what `server.serve` does."""
    from skyfolio.api.plans.solver import flight_lane  # noqa: PLC0415 - loads the planner's models

    # the server replaces this handler while it runs, and puts it back when it ends
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    kernels.report_temporary_folder(print_error)
    flight = flight_lane()
    gc.disable()  # a tenth of the imports' time would go into collections that find nothing
    try:
        flight.begin()
        from skyfolio.api.http import server  # noqa: PLC0415 - seconds of imports, while the worker loads

        server.serve(settings, as_json=as_json, ui=ui, flight=flight)
    finally:
        gc.enable()
        flight.close()
