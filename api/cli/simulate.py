"""`skyfolio simulate`: a software-only fleet as a process of its own."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Annotated

import typer

from skyfolio.api.cli.autopilots import DEFAULT, AutopilotOfFleet
from skyfolio.api.cli.field_options import BatteryMinutes, Crew, Fronts, PacksOfPad, Turnaround
from skyfolio.api.cli.files import Json, UsageError, read_as, read_scenario


def simulate(
    vehicles: Annotated[int, typer.Option(min=1, max=254, help="How many; system ids 1..N.")] = 3,
    speedup: Annotated[float, typer.Option(min=0.1, max=100, help="Times real time.")] = 1.0,
    autopilot: AutopilotOfFleet = DEFAULT,
    endpoint: Annotated[
        str,
        typer.Option(help="Where they send to, or several such URLs; HOST:FIRST-LAST gives each a port of its own."),
    ] = "udpout://127.0.0.1:14540",
    example: Annotated[str | None, typer.Option(help="Start at the start positions of this example.")] = None,
    plan_file: Annotated[
        Path | None,
        typer.Option("--plan", help="Start at this plan's start positions; report its slots, errors and true rates."),
    ] = None,
    duration_s: Annotated[float | None, typer.Option(min=0.1, help="End after this many fleet seconds.")] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="KIND:VEHICLE[@SECONDS|@slot=N][,KNOB=VALUE...]; may be given several times."),
    ] = None,
    up: Annotated[str, typer.Option(help="Impairment of the links to the vehicles: loss=0.1,latency_s=0.05.")] = "",
    down: Annotated[str, typer.Option(help="Impairment of the links from the vehicles.")] = "",
    weather: Annotated[
        str, typer.Option(help="E.g. wind_east_mps=4,gust_mps=1.5,gps_m=0.8; default: the scenario's wind.")
    ] = "",
    crew: Crew = None,
    turnaround_s: Turnaround = None,
    packs: PacksOfPad = None,
    battery_minutes: BatteryMinutes = None,
    front: Fronts = None,
    seed: Annotated[int, typer.Option(help="Of links, weather, packs and stream phases.")] = 0,
    radio_seed: Annotated[int, typer.Option(min=0, help="Of the fading that users truly experience.")] = 1,
    log: Annotated[Path | None, typer.Option(help="Write the ground truth here, as JSON lines.")] = None,
    tlog: Annotated[Path | None, typer.Option(help="Write all MAVLink here, as a .tlog.")] = None,
    booted_s_ago: Annotated[
        float,
        typer.Option(
            min=0, max=1e6, help="Seconds since the vehicles booted; an ArduCopter cannot be armed for 40 s after that."
        ),
    ] = 0.0,
    signing_key: Annotated[
        str,
        typer.Option(envvar="SKYFOLIO_SIM_SIGNING_KEY", help="64 hex digits: sign, and accept signed messages only."),
    ] = "",
    radio: Annotated[
        str,
        typer.Option(help="URL of a service: base stations serve what it says, and report what users truly get."),
    ] = "",
    radio_channel: Annotated[
        str, typer.Option(help="How the true channel differs: bias_db=-6,shadowing_db=4,rician_k_db=3,seed=1.")
    ] = "",
    radio_key: Annotated[
        str | None,
        typer.Option(envvar="SKYFOLIO_KEY", help="API key of the base stations; the role planner is enough."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Fly a software-only fleet that speaks MAVLink, until interrupted."""
    from skyfolio.api.common.configuration import require_known  # noqa: PLC0415 - `--help` needs none of these
    from skyfolio.api.lab.simulate import SimulateConfig, SimulateError, run_fleet  # noqa: PLC0415
    from skyfolio.planner import Plan  # noqa: PLC0415
    from skyfolio.sim import TURNAROUND_S, field_from  # noqa: PLC0415

    require_known(os.environ)
    try:
        field_knobs = field_from(
            crew=crew or 0,
            turnaround_s=turnaround_s or TURNAROUND_S,
            packs=packs or "",
            battery_minutes=battery_minutes,
            fronts=front or (),
        )
    except (ValueError, TypeError) as error:
        raise UsageError(str(error)) from error
    config = SimulateConfig(
        vehicles=vehicles,
        speedup=speedup,
        autopilot=autopilot,
        endpoint=endpoint,
        scenario=read_scenario(None, example) if example else None,
        plan=read_as(Plan, plan_file) if plan_file else None,
        duration_s=duration_s,
        faults=tuple(fault or ()),
        up=up,
        down=down,
        weather=weather,
        seed=seed,
        radio_seed=radio_seed,
        log=log,
        tlog=tlog,
        signing_key=signing_key,
        radio_url=radio,
        radio_channel=radio_channel,
        radio_key=radio_key,
        booted_s_ago=booted_s_ago,
        field_knobs=field_knobs,
        as_json=as_json,
    )
    try:
        asyncio.run(run_fleet(config))
    except SimulateError as error:
        raise UsageError(str(error)) from error
