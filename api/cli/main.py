"""The `skyfolio` command. Every command takes `--json` and then prints nothing but JSON on standard output."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from skyfolio.api.cli.autopilots import DEFAULT, AutopilotOfFleet
from skyfolio.api.cli.files import Json, Out
from skyfolio.api.cli.lazy import Later, LaterGroup

PLANNING = "skyfolio.api.cli.planning"


class _Commands(LaterGroup):
    later = {  # noqa: RUF012 - read only
        "plan": Later(f"{PLANNING}:plan_command", "Plan a scenario.", solves=True),
        "replan": Later(
            f"{PLANNING}:replan_command",
            "Plan the remaining slots of a plan: for the survivors, and for what else is different.",
            solves=True,
        ),
        "bound": Later(
            f"{PLANNING}:bound",
            "Plan a scenario of up to three UAVs and prove by branch and bound how good the plan is.",
            solves=True,
        ),
        "export": Later(
            f"{PLANNING}:export",
            "Write the MAVLink missions of a plan as QGroundControl `.plan`, `.waypoints` text or JSON.",
        ),
        "warm-up": Later(
            "skyfolio.api.cli.warm_up:warm_up", "Compile the optimiser's kernels now, so that nobody waits later."
        ),
        "fly": Later(
            "skyfolio.api.cli.remote:fly",
            "Plan a scenario at the service and fly it with the vehicles registered there.",
        ),
        "status": Later("skyfolio.api.cli.remote:status", "Show where an operation is, and each of its UAVs."),
        "drill": Later(
            "skyfolio.api.cli.remote:drill", "Let a fault strike a simulated vehicle, to see the service answer it."
        ),
        "fleet": Later("skyfolio.api.cli.remote:fleet", "Order vehicles of a service to hold, return or land now."),
        "check": Later(
            "skyfolio.api.cli.check:check",
            "Check vehicles on the ground: audit them, and try what is put on board; then restore what was there.",
        ),
        "keys": Later("skyfolio.api.cli.keys:keys", "API keys of the service."),
        "reproduce": Later(
            "skyfolio.api.lab.reproduce.commands:reproduce",
            "Compute the letter's figures and numbers and set them beside the printed ones.",
            solves=True,
        ),
        "tune-mu": Later(
            "skyfolio.api.lab.reproduce.commands:tune_mu",
            "Find the mu that meets limits on sum rate, fluctuation and fairness, in the worst of the given losses.",
            solves=True,
        ),
    }


cli = typer.Typer(
    cls=_Commands, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__
)
bench = typer.Typer(no_args_is_help=True, help="Measure; figures as JSON.")
cli.add_typer(bench, name="bench")


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
    from skyfolio.api.cli.serving import serve as run  # noqa: PLC0415

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
    autopilot: AutopilotOfFleet = DEFAULT,
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
    booted_s_ago: Annotated[
        float, typer.Option(min=0, max=1e6, help="Since when they are on; an ArduCopter cannot be armed for 40 s.")
    ] = 0.0,
    signing_key: Annotated[
        str, typer.Option(envvar="SKYFOLIO_SIM_SIGNING_KEY", help="64 hex digits: sign, and obey only who signs.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Fly a software-only fleet that speaks MAVLink, until interrupted."""
    import asyncio  # noqa: PLC0415

    from skyfolio.api.cli.files import UsageError, read_as, read_scenario  # noqa: PLC0415
    from skyfolio.api.common.configuration import require_known  # noqa: PLC0415
    from skyfolio.api.lab.simulate import SimulateConfig, SimulateError, run_fleet  # noqa: PLC0415
    from skyfolio.planner import Plan  # noqa: PLC0415

    require_known(os.environ)
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
        booted_s_ago=booted_s_ago,
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
    import asyncio  # noqa: PLC0415

    from rich.console import Console  # noqa: PLC0415

    from skyfolio.api.cli.files import write  # noqa: PLC0415
    from skyfolio.api.lab.demo import DemoConfig, DemoError, run_demo  # noqa: PLC0415
    from skyfolio.planner import Utility  # noqa: PLC0415

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
        Console(stderr=True).print(f"[red]the drill was not flown:[/] {error}", highlight=False)
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
    from skyfolio.api.lab.bench import planner_figures, table  # noqa: PLC0415

    figures = planner_figures(quick=quick)
    if as_json or out is not None:
        _write_json(figures, out)
    if not as_json:
        _show(table(figures))


@bench.command("report")
def bench_report(
    file: Annotated[Path, typer.Argument(help="Figures, as `skyfolio bench planner --json` prints them.")],
    out: Out = None,
) -> None:
    """Write the figures of a benchmark as Markdown."""
    import json  # noqa: PLC0415

    from skyfolio.api.cli.files import read, write  # noqa: PLC0415
    from skyfolio.api.lab.bench import markdown  # noqa: PLC0415

    write(markdown(json.loads(read(file))), out)


@bench.command("bridge")
def bench_bridge(
    seeds: Annotated[int, typer.Option(min=1, help="Lossy uploads to the fleet.")] = 100,
    swaps: Annotated[int, typer.Option(min=3, help="Missions swapped in flight, for each autopilot.")] = 20,
    load_s: Annotated[float, typer.Option(min=1, help="How long to measure the load of 50 vehicles.")] = 10.0,
    as_json: Json = False,
) -> None:
    """Measure the bridge on simulated PX4 and ArduCopter: schedule, uploads, swaps, loss detection, load."""
    from skyfolio.api.lab.bench.bridge import bridge_figures, tables  # noqa: PLC0415

    figures = bridge_figures(seeds=seeds, swaps=swaps, load_s=load_s)
    if as_json:
        _write_json(figures)
    else:
        for one in tables(figures):
            _show(one)


@bench.command("service")
def bench_service(
    runs: Annotated[int, typer.Option(min=2, help="Plans measured end to end.")] = 200,
    only: Annotated[list[str] | None, typer.Option(help="plans, rate, streams, recovery, loop; default: all.")] = None,
    as_json: Json = False,
) -> None:
    """Measure plans, requests a second, event streams, recovery from a loss, and what holds the event loop."""
    from skyfolio.api.lab.bench.service import service_figures, table  # noqa: PLC0415

    figures = service_figures(runs, set(only or []))
    if as_json:
        _write_json(figures)
    else:
        _show(table(figures))


@bench.command("start")
def bench_start(
    runs: Annotated[int, typer.Option(min=1, help="Starts of each, of which the median counts.")] = 5,
    as_json: Json = False,
) -> None:
    """Measure how long commands take to answer, and the service to come and to go."""
    from skyfolio.api.lab.bench.start import start_figures, table  # noqa: PLC0415

    figures = start_figures(runs)
    if as_json:
        _write_json(figures)
    else:
        _show(table(figures))


@bench.command("simulator")
def bench_simulator(
    vehicles: Annotated[int, typer.Option(min=1, max=254, help="How many.")] = 100,
    autopilot: AutopilotOfFleet = DEFAULT,
    position_hz: Annotated[float, typer.Option(min=0.1, max=50, help="Position messages a second, of each.")] = 10.0,
    seconds: Annotated[float, typer.Option(min=1, help="How long to measure.")] = 15.0,
    as_json: Json = False,
) -> None:
    """Measure how much of a core a simulated fleet takes at real time."""
    from skyfolio.api.lab.bench.simulator import simulator_figures, table  # noqa: PLC0415

    figures = simulator_figures(vehicles, autopilot, position_hz, seconds)
    if as_json:
        _write_json(figures)
    else:
        _show(table(figures))


def _write_json(figures: Any, out: Path | None = None) -> None:
    import json  # noqa: PLC0415

    from skyfolio.api.cli.files import write  # noqa: PLC0415

    write(json.dumps(figures, indent=2), out)


def _show(what: Any) -> None:
    from rich.console import Console  # noqa: PLC0415

    Console().print(what)


MISTAKES = {
    "skyfolio.api.cli.files": "UsageError",
    "skyfolio.api.common.errors": "ServiceError",
    "skyfolio.api.store.errors": "StoreError",
    "skyfolio.mavlink_bridge.errors": "BridgeError",
    "skyfolio.planner.changes": "ReplanError",
    "skyfolio.planner.unreachable": "UnreachableEndError",
}
"""Errors that a user can act on, by the module that has them: one that is not loaded cannot have raised any."""


def main() -> None:
    """Run the command; errors a user can act on are one message on standard error and exit status 2."""
    try:
        cli()
    except Exception as error:
        lines = _told(error)
        if not lines:
            raise
        from rich.console import Console  # noqa: PLC0415
        from rich.markup import escape  # noqa: PLC0415

        for line in lines:
            Console(stderr=True).print(f"[red]error:[/] {escape(line)}", highlight=False, soft_wrap=True)
        sys.exit(2)


def _told(error: Exception) -> list[str]:
    """What to tell the user, one message a line; nothing when it is not the user's mistake."""
    pydantic = sys.modules.get("pydantic")
    if pydantic is not None and isinstance(error, pydantic.ValidationError):
        from skyfolio.api.common.validation import broken_rules  # noqa: PLC0415

        return [f"{row['field']}: {row['message']}" for row in broken_rules(error.errors(), ())]
    kinds = tuple(getattr(sys.modules[home], name) for home, name in MISTAKES.items() if home in sys.modules)
    return str(error).splitlines() if isinstance(error, kinds) else []
