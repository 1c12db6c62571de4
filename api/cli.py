"""The `skyfolio` command. Every command takes `--json` and then prints nothing but JSON on standard output."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from pydantic import ValidationError
from rich.console import Console

from api import remote_cli, show
from api.errors import ServiceError
from api.keys_cli import keys
from api.problems import broken_rules
from api.reproduce.commands import reproduce, tune_mu
from api.store import StoreError
from mavlink_bridge import BridgeError
from planner import EXAMPLES, AnyOf, Deadline, Plan, ReplanError, Scenario, Utility, converged, plan, replan

cli = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)
bench = typer.Typer(no_args_is_help=True, help="Measure; figures as JSON.")
cli.add_typer(bench, name="bench")
cli.add_typer(keys, name="keys")
for _command in (remote_cli.fly, remote_cli.status, remote_cli.drill):
    cli.command()(_command)
cli.command("reproduce")(reproduce)
cli.command("tune-mu")(tune_mu)
errors = Console(stderr=True)

Json = Annotated[bool, typer.Option("--json", help="Print JSON only.")]
Out = Annotated[Path | None, typer.Option(help="Write the result here instead of printing it.")]
DeadlineS = Annotated[float | None, typer.Option(min=0.001, help="Return the best plan after this many seconds.")]


class UsageError(Exception):
    """The command line or a file given on it is wrong; exit status 2."""


@cli.command("plan")
def plan_command(
    file: Annotated[Path | None, typer.Argument(help="Scenario as JSON.")] = None,
    example: Annotated[str | None, typer.Option(help=f"Plan a ready scenario: {', '.join(EXAMPLES)}.")] = None,
    deadline_s: DeadlineS = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Plan a scenario."""
    scenario = _scenario(file, example)
    _deliver(plan(scenario, stop=_stop(deadline_s), clock=time.perf_counter), out, as_json)


@cli.command("replan")
def replan_command(
    file: Annotated[Path, typer.Argument(help="Plan as JSON, as `skyfolio plan --json` prints it.")],
    failed: Annotated[list[str], typer.Option(help="A UAV that is gone; may be given several times.")],
    at_slot: Annotated[int, typer.Option(min=0, help="First slot to plan, counted from 0.")],
    deadline_s: DeadlineS = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Plan the remaining slots for the survivors of a plan."""
    previous = Plan.model_validate_json(_read(file))
    made = replan(previous, failed=failed, at_slot=at_slot, stop=_stop(deadline_s), clock=time.perf_counter)
    _deliver(made, out, as_json)


@cli.command()
def export(
    file: Annotated[Path, typer.Argument(help="Plan as JSON.")],
    uav_id: Annotated[str | None, typer.Option(help="Which UAV; not needed for --format json.")] = None,
    format: Annotated[Literal["plan", "waypoints", "json"], typer.Option(help="File format.")] = "plan",  # noqa: A002
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Write the MAVLink missions of a plan as QGroundControl `.plan`, `.waypoints` text or JSON."""
    from api import missions  # noqa: PLC0415 - MAVSDK is only loaded where it is used

    made = Plan.model_validate_json(_read(file))
    if format == "json" or as_json:
        text = json.dumps(missions.as_json(made, uav_id), indent=2)
    elif format == "plan":
        text = json.dumps(missions.qgc_plan(made, uav_id), indent=4)
    else:
        text = missions.waypoints(made, uav_id)
    _write(text, out)


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
        scenario=_scenario(None, example) if example else None,
        plan=Plan.model_validate_json(_read(plan_file)) if plan_file else None,
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
        _write(report.model_dump_json(indent=2), None)
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
        _write(json.dumps(figures, indent=2), out)
    if not as_json:
        Console().print(table(figures))


@bench.command("report")
def bench_report(
    file: Annotated[Path, typer.Argument(help="Figures, as `skyfolio bench planner --json` prints them.")],
    out: Out = None,
) -> None:
    """Write the figures of a benchmark as Markdown."""
    from api.bench import markdown  # noqa: PLC0415

    _write(markdown(json.loads(_read(file))), out)


@cli.command("bound")
def bound_command(
    file: Annotated[Path | None, typer.Argument(help="Scenario as JSON.")] = None,
    example: Annotated[str | None, typer.Option(help=f"A ready scenario: {', '.join(EXAMPLES)}.")] = None,
    tolerance: Annotated[float, typer.Option(min=1e-6, max=1, help="Relative gap at which a slot is settled.")] = 0.005,
    seconds: Annotated[float, typer.Option(min=0.001, help="Stop branching after this long; the bound holds.")] = 60.0,
    as_json: Json = False,
) -> None:
    """Plan a scenario of up to three UAVs and prove by branch and bound how good the plan is."""
    from api.certify import TooManyUavsError, certify, shown  # noqa: PLC0415

    try:
        figures = certify(_scenario(file, example), tolerance=tolerance, seconds=seconds)
    except TooManyUavsError as error:
        raise UsageError(str(error)) from error
    if as_json:
        _write(json.dumps(figures, indent=2), None)
    else:
        Console().print(shown(figures), highlight=False)


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
        _write(json.dumps(figures, indent=2), None)
    else:
        for one in tables(figures):
            Console().print(one)


@bench.command("service")
def bench_service(
    runs: Annotated[int, typer.Option(min=2, help="Plans measured end to end.")] = 200,
    only: Annotated[list[str] | None, typer.Option(help="plans, rate, streams or recovery; default: all.")] = None,
    as_json: Json = False,
) -> None:
    """Measure the service from outside: plans, requests a second, event streams, recovery from a loss."""
    from api.bench.service import service_figures, table  # noqa: PLC0415

    figures = service_figures(runs, set(only or []))
    if as_json:
        _write(json.dumps(figures, indent=2), None)
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
        _write(json.dumps(figures, indent=2), None)
    else:
        Console().print(table(figures))


def main() -> None:
    """Run the command; errors a user can act on are one message on standard error and exit status 2."""
    try:
        cli()
    except ValidationError as error:
        for row in broken_rules(error.errors(), ()):
            errors.print(f"[red]error:[/] {row['field']}: {row['message']}", highlight=False)
        sys.exit(2)
    except (UsageError, ReplanError, BridgeError, ServiceError, StoreError) as error:
        errors.print(f"[red]error:[/] {error}", highlight=False)
        sys.exit(2)


def _scenario(file: Path | None, example: str | None) -> Scenario:
    if (file is None) == (example is None):
        raise UsageError("give a scenario FILE or --example NAME, one of them")
    if file is not None:
        return Scenario.model_validate_json(_read(file))
    if example not in EXAMPLES:
        raise UsageError(f"--example: {example!r} must be one of {', '.join(EXAMPLES)}")
    return EXAMPLES[example]()


def _stop(deadline_s: float | None) -> AnyOf:
    if deadline_s is None:
        return converged()
    return AnyOf(converged(), Deadline(deadline_s, clock=time.monotonic))


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{file}: {error}") from error


def _deliver(made: Plan, out: Path | None, as_json: bool) -> None:
    if as_json or out is not None:
        _write(made.model_dump_json(indent=2), out)
    if not as_json:
        Console().print(show.plan_table(made))


def _write(text: Any, out: Path | None) -> None:
    if out is None:
        sys.stdout.write(text.rstrip("\n") + "\n")
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
