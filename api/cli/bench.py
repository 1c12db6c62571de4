"""`skyfolio bench`: measurements of the planner, the bridge, the service, the simulator and the start of commands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyfolio.api.cli.autopilots import DEFAULT, AutopilotOfFleet
from skyfolio.api.cli.files import Json, Out, read, write
from skyfolio.api.cli.lazy import application

if TYPE_CHECKING:
    from rich.table import Table

bench = application("Measure this machine; figures as JSON.")


@bench.command()
def planner(
    quick: Annotated[bool, typer.Option("--quick", help="Only the two smaller sizes, few runs: a minute.")] = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Time the planner at four sizes and measure how good its plans are, beside other solvers; an hour."""
    from skyfolio.api.lab.bench import planner_figures, table  # noqa: PLC0415 - each command loads what it measures

    figures = planner_figures(quick=quick)
    if as_json or out is not None:
        write(json.dumps(figures, indent=2), out)
    if not as_json:
        _print_tables(table(figures))


@bench.command()
def report(
    file: Annotated[Path, typer.Argument(help="Figures, as `skyfolio bench planner --json` prints them.")],
    out: Out = None,
) -> None:
    """Write the figures of a benchmark as Markdown."""
    from skyfolio.api.lab.bench import markdown  # noqa: PLC0415

    write(markdown(json.loads(read(file))), out)


@bench.command()
def bridge(
    seeds: Annotated[int, typer.Option(min=1, help="Lossy uploads to the fleet.")] = 100,
    swaps: Annotated[int, typer.Option(min=3, help="Missions swapped in flight, for each autopilot.")] = 20,
    load_s: Annotated[float, typer.Option(min=1, help="How long to measure the load of 50 vehicles.")] = 10.0,
    as_json: Json = False,
) -> None:
    """Measure the bridge on simulated PX4 and ArduCopter: schedule, uploads, swaps, loss detection, load."""
    from skyfolio.api.lab.bench.bridge import bridge_figures, tables  # noqa: PLC0415

    figures = bridge_figures(seeds=seeds, swaps=swaps, load_s=load_s)
    _print(figures, *(() if as_json else tables(figures)))


@bench.command()
def service(
    runs: Annotated[int, typer.Option(min=2, help="Plans measured end to end.")] = 200,
    only: Annotated[list[str] | None, typer.Option(help="plans, rate, streams, recovery, loop; default: all.")] = None,
    as_json: Json = False,
) -> None:
    """Measure plans, requests per second, event streams, recovery from a loss, and what blocks the event loop."""
    from skyfolio.api.lab.bench.service import service_figures, table  # noqa: PLC0415

    figures = service_figures(runs, set(only or []))
    _print(figures, *(() if as_json else [table(figures)]))


@bench.command()
def scale(
    cases: Annotated[int, typer.Option(min=8, help="Cases of the sweep that is measured.")] = 160,
    kills: Annotated[int, typer.Option(min=1, help="Workers that are killed, one every 30 s.")] = 4,
    quick: Annotated[bool, typer.Option("--quick", help="Every part once, at the smallest sizes; for tests.")] = False,
    database_url: Annotated[
        str | None, typer.Option(help="An empty PostgreSQL database: how many events a second it stores, too.")
    ] = None,
    out: Out = None,
    page: Annotated[Path | None, typer.Option(help="Write the figures as Markdown here, too.")] = None,
    as_json: Json = False,
) -> None:
    """Measure how sweeps scale, how far one service goes, and calculate what many areas need; 15 minutes."""
    from skyfolio.api.common import extras  # noqa: PLC0415 - each command loads what it measures

    extras.require_all("sweep", "bench scale")
    from skyfolio.api.lab.bench.scale import QUICK, Extent, scale_figures  # noqa: PLC0415
    from skyfolio.api.lab.bench.scale_page import markdown, tables  # noqa: PLC0415

    def note(part: str) -> None:
        typer.echo(f"measuring: {part}", err=True)

    figures = scale_figures(QUICK if quick else Extent(cases=cases, kills=kills), database_url, note)
    if page is not None:
        write(markdown(figures), page)
    if as_json or out is not None:
        write(json.dumps(figures, indent=2), out)
    if not as_json:
        _print_tables(*tables(figures))


@bench.command()
def start(
    runs: Annotated[int, typer.Option(min=1, help="Starts of each; the median is reported.")] = 5,
    as_json: Json = False,
) -> None:
    """Measure how long commands take to answer, and the service to start and to stop."""
    from skyfolio.api.lab.bench.start import start_figures, table  # noqa: PLC0415

    figures = start_figures(runs)
    _print(figures, *(() if as_json else [table(figures)]))


@bench.command()
def simulator(
    vehicles: Annotated[int, typer.Option(min=1, max=254, help="How many.")] = 100,
    autopilot: AutopilotOfFleet = DEFAULT,
    position_hz: Annotated[
        float, typer.Option(min=0.1, max=50, help="Position messages per second, from each.")
    ] = 10.0,
    seconds: Annotated[float, typer.Option(min=1, help="How long to measure.")] = 15.0,
    as_json: Json = False,
) -> None:
    """Measure how much of a core a simulated fleet takes at real time."""
    from skyfolio.api.lab.bench.simulator import simulator_figures, table  # noqa: PLC0415

    figures = simulator_figures(vehicles, autopilot, position_hz, seconds)
    _print(figures, *(() if as_json else [table(figures)]))


@bench.command()
def radio(
    layouts: Annotated[int, typer.Option(min=1, help="User layouts of the letter's size.")] = 8,
    air: Annotated[
        int, typer.Option(min=1, help="Draws of the fading, unseen by planners, that judge each plan.")
    ] = 64,
    large: Annotated[bool, typer.Option("--large", help="Also ten UAVs and a hundred users.")] = False,
    as_json: Json = False,
) -> None:
    """Measure what planning for expected rates gains over planning on the mean channel, and its time."""
    from skyfolio.api.lab.bench.radio import radio_figures, table  # noqa: PLC0415

    figures = radio_figures(layouts, air, large=large)
    _print(figures, *(() if as_json else [table(figures)]))


def _print(figures: dict[str, Any], *tables: Table) -> None:
    """Print the tables, or the figures as JSON when there are none."""
    if tables:
        _print_tables(*tables)
    else:
        write(json.dumps(figures, indent=2), None)


def _print_tables(*tables: Table) -> None:
    from rich.console import Console  # noqa: PLC0415

    console = Console()
    for table in tables:
        console.print(table)
