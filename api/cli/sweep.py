"""`skyfolio sweep`: many scenarios and many ways to plan them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table

from skyfolio.api.cli.files import Json, write
from skyfolio.api.lab.sweep.results import summary_of, write_results
from skyfolio.api.lab.sweep.run import Advance, Outcome, run_sweep
from skyfolio.api.lab.sweep.spec import read_spec

if TYPE_CHECKING:
    import pandas as pd

console = Console(stderr=True)
MOST_ROWS = 40
ENDLESS = 10_000
"""Columns of a terminal in which everything has room."""
PACE_OF_S = 600.0
"""The time left is estimated from the last so many seconds, in which even slow batches end."""
SHOWN = {
    "mean_sum_rate_bps_mean": ("sum rate, kbit/s", 1e-3, ".2f"),
    "sum_rate_variance_kbps2_mean": ("variance, (kbit/s)²", 1.0, ".2f"),
    "jain_mean": ("Jain", 1.0, ".3f"),
    "least_user_rate_bps_mean": ("least user, kbit/s", 1e-3, ".2f"),
    "gap_mean": ("gap", 100.0, ".2f"),
    "solve_ms_mean": ("solved in, ms", 1.0, ".1f"),
}


def sweep(
    spec: Annotated[Path, typer.Argument(help="What to plan, as TOML; docs/scaling.md says how.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the results; default: out/sweep/NAME of the file.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="tcp://HOST:PORT of a Dask scheduler; default: an own cluster on this machine.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes of the own cluster; default: one for each core.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Plan thousands of scenarios, as a TOML file asks, on all cores or on a Dask cluster.

    What is in the folder already is not computed again: the same command goes on where it was stopped. Ctrl-C stops it.
    Exit status 1: not all cases are computed.
    """
    folder = out or Path("out") / "sweep" / spec.stem
    with _progress(quiet=as_json) as advance:
        outcome = run_sweep(read_spec(spec), folder, scheduler=scheduler, workers=workers, advance=advance)
    files = write_results(folder) if outcome.stored and not outcome.stopped else []  # stopped, it ends at once
    if as_json:
        write(json.dumps(_as_data(outcome, folder, files), indent=1), None)
    else:
        _show(outcome, folder, files)
    raise typer.Exit(0 if outcome.complete else 1)


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Advance]:
    """Show a bar with the time left on standard error; what was stored before does not count in the pace."""
    left = TimeRemainingColumn(compact=True, elapsed_when_finished=True)
    columns = (TextColumn("cases"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), left)
    with Progress(*columns, console=console, disable=quiet, speed_estimate_period=PACE_OF_S) as bar:
        tasks: list[TaskID] = []

        def advance(stored: int, of: int) -> None:
            if tasks:
                bar.update(tasks[0], completed=stored)
            else:
                tasks.append(bar.add_task("cases", total=of, completed=stored))

        yield advance


def _as_data(outcome: Outcome, folder: Path, files: list[Path]) -> dict[str, Any]:
    summary = json.loads(summary_of(folder).to_json(orient="records")) if files else []
    told = {**vars(outcome), "computed": outcome.stored - outcome.found, "complete": outcome.complete}
    return {**told, "folder": str(folder), "files": [str(file) for file in files], "summary": summary}


def _show(outcome: Outcome, folder: Path, files: list[Path]) -> None:
    if files:
        console.print(_table(summary_of(folder), console.width))
    for error in outcome.errors:
        console.print(f"[red]not computed:[/] {error}", highlight=False)
    if outcome.broken > len(outcome.errors):
        console.print(f"and {outcome.broken - len(outcome.errors)} more batches", highlight=False)
    how = f"{outcome.found} were there, {outcome.stored - outcome.found} computed in {outcome.seconds:.1f} s"
    console.print(f"{outcome.stored} of {outcome.cases} cases: {how}", highlight=False)
    if files:
        console.print("written: " + ", ".join(str(file) for file in files), highlight=False)
    if not outcome.complete:
        console.print("the same command computes the rest")


def _table(summary: pd.DataFrame, width: int) -> Table:
    """Return the summary with as many measures as there is room for, so that no number is cut off."""
    shown = [name for name in SHOWN if name in summary.columns]
    endless = console.options.update(width=ENDLESS)
    while shown and Measurement.get(console, endless, _with(summary, shown)).maximum > width:
        shown.pop()
    return _with(summary, shown)


def _with(summary: pd.DataFrame, shown: list[str]) -> Table:
    by = list(summary.columns[: list(summary.columns).index("cases")])
    title = None if len(summary) <= MOST_ROWS else f"the first {MOST_ROWS} of {len(summary)} groups"
    headers = [name.replace(".", ".\n") for name in by]
    headers += ["cases", "planned", *(SHOWN[name][0].replace(", ", ",\n") for name in shown)]
    table = Table(*(Column(header, no_wrap=True) for header in headers), title=title)
    for row in summary.head(MOST_ROWS).to_dict("records"):
        measures = [format(row[name] * SHOWN[name][1], SHOWN[name][2]) for name in shown]
        table.add_row(*(_value(row[name]) for name in by), str(row["cases"]), str(row["planned"]), *measures)
    return table


def _value(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
