"""The `skyfolio` command. Every command takes `--json` and then prints nothing but JSON on standard output."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape

from api import planning_cli, remote_cli
from api.cli_files import Json, Out, UsageError, read, read_as, read_scenario, write
from api.errors import ServiceError
from api.keys_cli import keys
from api.reproduce.commands import reproduce, tune_mu
from api.rules import broken_rules
from api.store import StoreError
from mavlink_bridge import BridgeError
from planner import Plan, ReplanError, UnreachableEndError, Utility

cli = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)
bench = typer.Typer(no_args_is_help=True, help="Measure; figures as JSON.")
cli.add_typer(bench, name="bench")
cli.add_typer(keys, name="keys")
for _command in (remote_cli.fly, remote_cli.status, remote_cli.drill):
    cli.command()(_command)
cli.command("plan")(planning_cli.plan_command)
cli.command("replan")(planning_cli.replan_command)
cli.command()(planning_cli.export)
cli.command()(planning_cli.bound)
cli.command("reproduce")(reproduce)
cli.command("tune-mu")(tune_mu)
errors = Console(stderr=True)


@cli.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to bind; loopback unless told otherwise.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="TCP port.")] = None,
    database_url: Annotated[str | None, typer.Option(help="SQLite or PostgreSQL URL, or 'temporary'.")] = None,
    fleet_url: Annotated[str | None, typer.Option(help="Where vehicles are, e.g. udpin://127.0.0.1:14540.")] = None,
    simulate: Annotated[str | None, typer.Option(help="Fly this example's fleet in software, for drills.")] = None,
    time_scale: Annotated[float | None, typer.Option(help="Speed-up of a simulated fleet; 1 for real ones.")] = None,
    ui: Annotated[bool, typer.Option("--ui/--no-ui", help="Serve the dashboard at /ui.")] = True,
    as_json: Json = False,
) -> None:
    """Run the service. Settings also come from SKYFOLIO_* environment variables."""
    from api.serving import serve as run  # noqa: PLC0415

    given = {
        "host": host,
        "port": port,
        "database_url": database_url,
        "fleet_url": fleet_url,
        "simulate": simulate,
        "time_scale": time_scale,
    }
    run({name: value for name, value in given.items() if value is not None}, as_json=as_json, ui=ui)


@cli.command()
def simulate(
    vehicles: Annotated[int, typer.Option(min=1, max=254, help="How many; system ids 1..N.")] = 3,
    speedup: Annotated[float, typer.Option(min=0.1, max=100, help="Times real time.")] = 1.0,
    autopilot: Annotated[Literal["px4", "ardupilot"], typer.Option(help="Which autopilot they have.")] = "px4",
    endpoint: Annotated[str, typer.Option(help="Where they send to; HOST:FIRST-LAST: each to a port of its own.")] = (
        "udpout://127.0.0.1:14540"
    ),
    example: Annotated[str | None, typer.Option(help="Stand at the starts of this example.")] = None,
    plan_file: Annotated[
        Path | None, typer.Option("--plan", help="Stand at this plan's starts; tell its slots, errors and true rates.")
    ] = None,
    duration_s: Annotated[float | None, typer.Option(min=0.1, help="End after this many fleet seconds.")] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="KIND:VEHICLE[@SECONDS|@slot=N][,KNOB=VALUE...]; may be given several times."),
    ] = None,
    up: Annotated[str, typer.Option(help="What links to the vehicles do, e.g. loss=0.1,latency_s=0.05.")] = "",
    down: Annotated[str, typer.Option(help="What links from the vehicles do.")] = "",
    weather: Annotated[str, typer.Option(help="E.g. wind_east_mps=4,gust_mps=1.5,gps_m=0.8.")] = "",
    seed: Annotated[int, typer.Option(help="Of links, weather and stream phases.")] = 0,
    radio_seed: Annotated[int, typer.Option(min=0, help="Of the fading that users truly meet.")] = 1,
    log: Annotated[Path | None, typer.Option(help="Write the truth here, as JSON lines.")] = None,
    tlog: Annotated[Path | None, typer.Option(help="Write all MAVLink here, as a .tlog.")] = None,
    signing_key: Annotated[
        str, typer.Option(envvar="SKYFOLIO_SIM_SIGNING_KEY", help="64 hex digits: sign, and obey only who signs.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Fly a software-only fleet that speaks MAVLink, until interrupted."""
    from api.simulate import SimulateConfig, SimulateError, run_fleet  # noqa: PLC0415

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
        as_json=as_json,
    )
    try:
        asyncio.run(run_fleet(config))
    except SimulateError as error:
        raise UsageError(str(error)) from error


@cli.command()
def demo(
    speedup: Annotated[float, typer.Option(min=1, max=20, help="Times real time.")] = 5.0,
    kill: Annotated[str, typer.Option(help="The UAV that falls.")] = "uav-3",
    kill_slot: Annotated[int, typer.Option(min=2, help="It falls when this slot begins; 1 is the first.")] = 11,
    replan: Annotated[bool, typer.Option("--replan/--no-replan", help="Whether the service answers the loss.")] = True,
    utility: Annotated[Literal["sum", "per_user", "pooled"], typer.Option(help="What the plans maximise.")] = "pooled",
    mu: Annotated[float, typer.Option(max=0, help="1/(kbit/s): 0 is pure sum rate, more negative is steadier.")] = -0.3,
    out: Annotated[Path, typer.Option(help="Folder of report.html and report.json.")] = Path("out/demo"),
    as_json: Json = False,
) -> None:
    """Plan, fly, lose a UAV, replan, fly on, and check it all against the simulator's ground truth."""
    from api.demo import DemoConfig, DemoError, run_demo  # noqa: PLC0415

    config = DemoConfig(
        speedup=speedup,
        kill=kill,
        kill_slot=kill_slot,
        replan=replan,
        out=out,
        utility=Utility(kind=utility, mu_per_kbps=mu),
    )
    try:
        report = asyncio.run(run_demo(config, quiet=as_json))
    except DemoError as error:
        errors.print(f"[red]the drill was not flown:[/] {error}", highlight=False)
        raise typer.Exit(1) from error
    if as_json:
        write(report.model_dump_json(indent=2), None)
    raise typer.Exit(0 if report.passed else 1)


@bench.command("planner")
def bench_planner(
    quick: Annotated[bool, typer.Option("--quick", help="Only the two smaller sizes, few runs: a minute.")] = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Time the planner at four sizes, beside its reference path and IPOPT; ten minutes."""
    from api.bench import planner_figures, table  # noqa: PLC0415

    figures = planner_figures(quick=quick)
    if as_json or out is not None:
        write(json.dumps(figures, indent=2), out)
    if not as_json:
        Console().print(table(figures))


@bench.command("report")
def bench_report(
    file: Annotated[Path, typer.Argument(help="Figures, as `skyfolio bench planner --json` prints them.")],
    out: Out = None,
) -> None:
    """Write the figures of a benchmark as Markdown."""
    from api.bench import markdown  # noqa: PLC0415

    write(markdown(json.loads(read(file))), out)


@bench.command("bridge")
def bench_bridge(
    seeds: Annotated[int, typer.Option(min=1, help="Lossy uploads to the fleet.")] = 100,
    swaps: Annotated[int, typer.Option(min=3, help="Missions swapped in flight, for each autopilot.")] = 20,
    load_s: Annotated[float, typer.Option(min=1, help="How long to measure the load of 50 vehicles.")] = 10.0,
    as_json: Json = False,
) -> None:
    """Measure the bridge on simulated PX4 and ArduCopter: schedule, uploads, swaps, loss detection, load."""
    from api.bench.bridge import bridge_figures, tables  # noqa: PLC0415

    figures = bridge_figures(seeds=seeds, swaps=swaps, load_s=load_s)
    if as_json:
        write(json.dumps(figures, indent=2), None)
    else:
        for one in tables(figures):
            Console().print(one)


@bench.command("service")
def bench_service(
    runs: Annotated[int, typer.Option(min=2, help="Plans measured end to end.")] = 200,
    only: Annotated[list[str] | None, typer.Option(help="plans, rate, streams, recovery, loop; default: all.")] = None,
    as_json: Json = False,
) -> None:
    """Measure plans, requests a second, event streams, recovery from a loss, and what holds the event loop."""
    from api.bench.service import service_figures, table  # noqa: PLC0415

    figures = service_figures(runs, set(only or []))
    if as_json:
        write(json.dumps(figures, indent=2), None)
    else:
        Console().print(table(figures))


@bench.command("simulator")
def bench_simulator(
    vehicles: Annotated[int, typer.Option(min=1, max=254, help="How many.")] = 100,
    autopilot: Annotated[Literal["px4", "ardupilot"], typer.Option(help="Which autopilot they have.")] = "px4",
    position_hz: Annotated[float, typer.Option(min=0.1, max=50, help="Position messages a second, of each.")] = 10.0,
    seconds: Annotated[float, typer.Option(min=1, help="How long to measure.")] = 15.0,
    as_json: Json = False,
) -> None:
    """Measure how much of a core a simulated fleet takes at real time."""
    from api.bench.simulator import simulator_figures, table  # noqa: PLC0415

    figures = simulator_figures(vehicles, autopilot, position_hz, seconds)
    if as_json:
        write(json.dumps(figures, indent=2), None)
    else:
        Console().print(table(figures))


def main() -> None:
    """Run the command; errors a user can act on are one message on standard error and exit status 2."""
    try:
        cli()
    except ValidationError as error:
        _refuse(f"{row['field']}: {row['message']}" for row in broken_rules(error.errors(), ()))
    except (UsageError, ReplanError, UnreachableEndError, BridgeError, ServiceError, StoreError) as error:
        _refuse(str(error).splitlines())


def _refuse(messages: Iterable[str]) -> NoReturn:
    """Tell on standard error what is wrong, one message a line, and end with status 2."""
    for message in messages:
        errors.print(f"[red]error:[/] {escape(message)}", highlight=False, soft_wrap=True)
    sys.exit(2)
