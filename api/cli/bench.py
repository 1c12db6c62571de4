"""`skyfolio bench`: measurements of the planner, the bridge, the service, the simulator and the start of commands."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import StrEnum
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyfolio.api.cli.autopilots import DEFAULT, AutopilotOfFleet
from skyfolio.api.cli.files import Json, Out, UsageError, read, write
from skyfolio.api.cli.lazy import application

if TYPE_CHECKING:
    from rich.table import Table

bench = application("Measure this machine; figures as JSON.")


@bench.command()
def planner(
    quick: Annotated[bool, typer.Option("--quick", help="Only the two smaller sizes, few runs: some minutes.")] = False,
    full: Annotated[
        bool, typer.Option("--full", help="More repetitions, layouts and peers: more than an hour.")
    ] = False,
    section: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this section (may be repeated): quality, fast, reference, ipopt, ablation, users, channels, "
            "energy, terrain, disruption, bound, budgets, peers, proof, checked."
        ),
    ] = None,
    size: Annotated[list[str] | None, typer.Option(help="Only this size, such as 10x100x50 (may be repeated).")] = None,
    utility: Annotated[list[str] | None, typer.Option(help="Only this utility (may be repeated).")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Keep the figures here; those of parts that are not measured now stay.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure how good plans are, what they take, and other solvers beside them; 25 minutes on two idle cores."""
    from skyfolio.api.lab.bench import best_known  # noqa: PLC0415 - each command loads what it measures
    from skyfolio.api.lab.bench.effort import DEFAULT, FULL, QUICK  # noqa: PLC0415
    from skyfolio.api.lab.bench.parts import chosen  # noqa: PLC0415
    from skyfolio.api.lab.bench.planner import measure  # noqa: PLC0415
    from skyfolio.api.lab.bench.quality_page import quality_table  # noqa: PLC0415
    from skyfolio.api.lab.bench.report import table  # noqa: PLC0415

    if quick and full:
        raise UsageError("--quick, --full: give one of them")
    if out is not None and not out.absolute().parent.is_dir():
        raise UsageError(f"--out: there is no folder {out.absolute().parent}")
    effort = QUICK if quick else FULL if full else DEFAULT
    known = best_known.FILE if not quick and best_known.FILE.parent.is_dir() else None
    try:
        parts = chosen(effort, sections=section or (), sizes=size or (), kinds=utility or ())
        figures = measure(parts, effort, file=out, best_known=known, told=_progress(len(parts)))
    except ValueError as error:
        raise UsageError(str(error)) from error
    if as_json and out is None:
        write(json.dumps(figures, indent=1), None)
    if not as_json:
        _print_tables(table(figures), quality_table(figures, best_known.load()))


def _progress(total: int) -> Callable[[str], None]:
    """Return what says on standard error how far the benchmark is."""
    number = count(1)
    return lambda text: typer.echo(f"[{next(number)}/{total}] {text}", err=True)


class Page(StrEnum):
    """The pages that are written from the figures of `skyfolio bench planner`."""

    PLANNER = "planner"
    QUALITY = "quality"


@bench.command()
def report(
    file: Annotated[Path, typer.Argument(help="Figures, as `skyfolio bench planner --out` keeps them.")],
    page: Annotated[Page, typer.Option(help="Beside other solvers, or how good plans of fleets are.")] = Page.PLANNER,
    out: Out = None,
) -> None:
    """Write a page from the figures of a benchmark, as Markdown."""
    from skyfolio.api.lab.bench import best_known, figures  # noqa: PLC0415 - each command loads what it measures
    from skyfolio.api.lab.bench.quality_page import quality_markdown  # noqa: PLC0415
    from skyfolio.api.lab.bench.report import markdown  # noqa: PLC0415

    try:
        measured = figures.parsed(read(file), str(file))
    except ValueError as error:
        raise UsageError(str(error)) from error
    write(markdown(measured) if page is Page.PLANNER else quality_markdown(measured, best_known.load()), out)


@bench.command()
def bridge(
    seeds: Annotated[int, typer.Option(min=1, help="Lossy uploads to the fleet.")] = 100,
    swaps: Annotated[int, typer.Option(min=3, help="Missions swapped in flight, for each autopilot.")] = 20,
    load_s: Annotated[float, typer.Option(min=1, help="Seconds in which the load of 50 vehicles is measured.")] = 10.0,
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
    _give(figures, tables(figures), out, as_json=as_json)


@bench.command()
def areas(
    uavs: Annotated[list[int] | None, typer.Option(min=2, help="UAVs; by default 100, 200 and 500.")] = None,
    compare: Annotated[bool, typer.Option(help="Also plan smaller fleets both by areas and at once.")] = True,
    out: Out = None,
    page: Annotated[Path | None, typer.Option(help="Write the figures as Markdown here, too.")] = None,
    as_json: Json = False,
) -> None:
    """Measure plans of large fleets by areas, replans after a loss, and plans at once beside them; some minutes."""
    from skyfolio.api.lab.bench.areas import COMPARED, SIZES, areas_figures, markdown, tables  # noqa: PLC0415

    figures = areas_figures(
        uavs or SIZES, COMPARED if compare else (), told=lambda row: typer.echo(json.dumps(row), err=True)
    )
    if page is not None:
        write(markdown(figures), page)
    _give(figures, tables(figures), out, as_json=as_json)


@bench.command()
def energy(
    flights: Annotated[int, typer.Option(min=2, help="Flights in wind, half of them of each autopilot.")] = 200,
    out: Out = None,
    page: Annotated[Path | None, typer.Option(help="Write the figures as Markdown here, too.")] = None,
    as_json: Json = False,
) -> None:
    """Measure how well plans predict the energy of flights in wind, on both simulated autopilots, in virtual time."""
    from skyfolio.api.lab.bench.energy import energy_figures, markdown, table  # noqa: PLC0415

    figures = energy_figures(flights, told=lambda text: typer.echo(text, err=True))
    if page is not None:
        write(markdown(figures), page)
    _give(figures, [table(figures)], out, as_json=as_json)


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
        float, typer.Option(min=0.1, max=50, help="Position messages from each vehicle, Hz.")
    ] = 10.0,
    seconds: Annotated[float, typer.Option(min=1, help="Seconds to measure.")] = 15.0,
    as_json: Json = False,
) -> None:
    """Measure how much of a core a simulated fleet takes at real time."""
    from skyfolio.api.lab.bench.simulator import simulator_figures, table  # noqa: PLC0415

    figures = simulator_figures(vehicles, autopilot, position_hz, seconds)
    _print(figures, *(() if as_json else [table(figures)]))


@bench.command()
def drills(
    runs: Annotated[int, typer.Option(min=1, help="Runs of each drill; best and median are reported.")] = 9,
    as_json: Json = False,
) -> None:
    """Measure how much of a core a whole drill in virtual time takes, and for what."""
    from skyfolio.api.lab.bench.drills import drill_figures, tables  # noqa: PLC0415

    figures = drill_figures(runs)
    _print(figures, *(() if as_json else tables(figures)))


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


@bench.command()
def channels(
    file: Annotated[
        Path, typer.Argument(help="CSV of measured links: away_m, height_m (of the UAV over the other end), gain_db.")
    ],
    carrier_hz: Annotated[float, typer.Option(min=1e8, max=1e11, help="Of the measurements, Hz.")] = 2e9,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Set every kind of channel beside measurements: by how much each is off once one offset is taken out."""
    from skyfolio.api.lab.bench.measured import links_of, measured_figures, table  # noqa: PLC0415

    try:
        figures = measured_figures(links_of(read(file)), carrier_hz)
    except ValueError as error:
        raise UsageError(f"{file}: {error}") from error
    _give(figures, [table(figures)], out, as_json=as_json)


@bench.command()
def allocations(
    seeds: Annotated[int, typer.Option(min=1, help="Of the fleet and of the shadowing; each takes some minutes.")] = 3,
    out: Out = None,
    page: Annotated[Path | None, typer.Option(help="Write the figures as Markdown here, too.")] = None,
    as_json: Json = False,
) -> None:
    """Measure, in virtual time, what correcting the channel in flight and serving users at once after a loss gain."""
    from skyfolio.api.lab.bench.allocations import allocation_figures, markdown, tables  # noqa: PLC0415
    from skyfolio.api.lab.torture.campaign import quiet  # noqa: PLC0415

    with quiet():
        figures = allocation_figures(seeds, told=lambda row: typer.echo(json.dumps(row), err=True))
    if page is not None:
        write(markdown(figures), page)
    _give(figures, tables(figures), out, as_json=as_json)


def _print(figures: dict[str, Any], *tables: Table) -> None:
    """Print the tables, or the figures as JSON when there are none."""
    if tables:
        _print_tables(*tables)
    else:
        write(json.dumps(figures, indent=2), None)


def _give(figures: dict[str, Any], tables: list[Table], out: Path | None, *, as_json: bool) -> None:
    """Write the figures to `out`, or print them as JSON; print the tables unless only JSON is asked for."""
    if as_json or out is not None:
        write(json.dumps(figures, indent=2), out)
    if not as_json:
        _print_tables(*tables)


def _print_tables(*tables: Table) -> None:
    from rich.console import Console  # noqa: PLC0415

    console = Console()
    for table in tables:
        console.print(table)
