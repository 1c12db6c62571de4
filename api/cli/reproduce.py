"""`skyfolio reproduce` and `skyfolio tune-mu`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from skyfolio.api.cli.files import Json, read_as, write
from skyfolio.api.common import extras
from skyfolio.api.lab.reproduce import figures
from skyfolio.api.lab.reproduce.batch import Advance, Batch
from skyfolio.api.lab.reproduce.calibration import calibrate
from skyfolio.api.lab.reproduce.cluster import ClusterBatch
from skyfolio.api.lab.reproduce.courses import Choices
from skyfolio.api.lab.reproduce.document import document
from skyfolio.api.lab.reproduce.study import StudyConfig, run_study
from skyfolio.api.lab.reproduce.study import write as write_study
from skyfolio.api.lab.reproduce.tuning import Limits, Tuning, closest, spread, tune
from skyfolio.planner import EXAMPLES, Scenario

console = Console(stderr=True)
CALIBRATION_LAYOUTS = 4


def reproduce(
    figure: Annotated[Literal["2", "3", "5a", "5b", "all"], typer.Option(help="Which figure of the letter.")] = "all",
    out: Annotated[Path, typer.Option(help="Folder of reproduction.md and its figures.")] = Path("out"),
    layouts: Annotated[int | None, typer.Option(min=2, help="User layouts; each UAV fails in turn in each.")] = None,
    draws: Annotated[int, typer.Option(min=1, help="Draws of the fading that are averaged.")] = Choices.draws,
    search: Annotated[
        bool, typer.Option("--calibrate", help="Instead, search for the values that the letter omits.")
    ] = False,
    scheduler: Annotated[
        str | None, typer.Option(help="Compute on this Dask scheduler (tcp://HOST:PORT), not on all cores here.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute the letter's figures and numbers and set them beside the printed ones.

    The write-up includes what `--calibrate` has left in the same folder.
    """
    kept = out / "reproduction" / "calibration.json"
    if search:
        _calibrate(kept, layouts or CALIBRATION_LAYOUTS, scheduler, as_json=as_json)
        return
    extras.require("matplotlib", "drawing the figures")
    config = StudyConfig(figure=figure, layouts=layouts or StudyConfig.layouts, draws=draws)
    calibration = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else None
    with progress(f"figure {figure}", quiet=as_json) as advance, _computing(advance, scheduler) as runs:
        study = run_study(config, runs, calibration)
    files = write_study(study, out, document)
    if as_json:
        _print(study)
        return
    if "claims" in study:
        console.print(claims_table(study))
    console.print("written: " + ", ".join(str(path) for path in files), highlight=False)


def _computing(advance: Advance, scheduler: str | None) -> Batch | ClusterBatch:
    """Return what computes the jobs: the workers of a cluster, or processes of this machine."""
    return Batch(advance) if scheduler is None else ClusterBatch(advance, scheduler)


def _calibrate(kept: Path, layouts: int, scheduler: str | None, *, as_json: bool) -> None:
    with progress("calibrating", quiet=as_json) as advance, _computing(advance, scheduler) as batch:
        found = calibrate(batch, layouts)
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if as_json:
        _print(found)
        return
    best = found["best"]
    console.print(f"best of {found['settings']}, {best['misfit']:.1%} off: " + ", ".join(best["setting"].values()))
    console.print(f"written: {kept}", highlight=False)


def tune_mu(
    file: Annotated[Path | None, typer.Argument(help="Scenario as JSON; default: the paper example.")] = None,
    min_sum_rate: Annotated[float | None, typer.Option(min=0, help="kbit/s, mean over all slots.")] = None,
    max_variance: Annotated[float | None, typer.Option(min=0, help="(kbit/s)^2, of the sum rate over slots.")] = None,
    min_jain: Annotated[float | None, typer.Option(min=0, max=1, help="Jain index of the users' mean rates.")] = None,
    kind: Annotated[Literal["sum", "per_user", "pooled"], typer.Option(help="The utility.")] = "pooled",
    failed: Annotated[list[str] | None, typer.Option(help="UAVs that fail, each in turn; default: every one.")] = None,
    at_slot: Annotated[int | None, typer.Option(min=1, help="When they fail, from 0; default: half way.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the trade-off curve into this PNG or SVG.")] = None,
    as_json: Json = False,
) -> None:
    """Find the mu that meets limits on sum rate, fluctuation and fairness, in the worst of the given losses."""
    if plot is not None:
        extras.require("matplotlib", "--plot")
    scenario = read_as(Scenario, file) if file else EXAMPLES["paper"]()
    limits = Limits(min_sum_rate_kbps=min_sum_rate, max_variance_kbps2=max_variance, min_jain=min_jain)
    with progress("scanning mu", quiet=as_json) as advance:
        tuning = tune(
            scenario,
            kind,
            limits,
            losses=scenario.uav_ids if failed is None else failed,
            at_slot=scenario.slots // 2 if at_slot is None else at_slot,
            advance=advance,
        )
    if plot is not None:
        plot.parent.mkdir(parents=True, exist_ok=True)
        figures.trade_off(
            [row.model_dump() for row in tuning.rows if row.mu_per_kbps < 0], tuning.chosen_mu_per_kbps
        ).savefig(plot)
    if as_json:
        _print(tuning.model_dump(mode="json"))
    else:
        _show(tuning)
    raise typer.Exit(0 if tuning.chosen_mu_per_kbps is not None else 1)


@contextmanager
def progress(what: str, *, quiet: bool) -> Iterator[Advance]:
    """Show a bar on standard error that `advance(done, of)` moves."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=quiet) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def claims_table(study: dict[str, Any]) -> Table:
    """Return the verdicts as a table for a terminal."""
    table = Table(
        "fig.", "claim", "letter", "ours", "verdict", title=f"{study['cases']} cases, {study['seconds']:.0f} s"
    )
    colours = {"reproduced": "green", "trend only": "yellow", "open": "cyan", "not reproducible": "red"}
    for claim in study["claims"]:
        paper = "-" if claim["paper"] is None else f"{claim['paper']:.4g}"
        ours = f"{claim['ours']:.4g}" + ("" if claim["half"] is None else f" ± {claim['half']:.2g}")
        verdict = f"[{colours[claim['verdict']]}]{claim['verdict']}[/]"
        table.add_row(claim["figure"], claim["claim"], paper, f"{ours} {claim['unit']}", verdict)
    return table


def _show(tuning: Tuning) -> None:
    table = Table("mu, 1/(kbit/s)", "sum rate, kbit/s", "variance, (kbit/s)²", "Jain", "limits missed")
    for row in tuning.rows:
        mark = "bold green" if row.mu_per_kbps == tuning.chosen_mu_per_kbps else ""
        table.add_row(
            f"{row.mu_per_kbps:.4g}",
            f"{row.mean_sum_rate_kbps:.2f}",
            f"{row.variance_kbps2:.2f}",
            f"{row.jain:.3f}",
            ", ".join(row.missed) or "none",
            style=mark,
        )
    console.print(table)
    if tuning.chosen_mu_per_kbps is not None:
        console.print(f"mu = {tuning.chosen_mu_per_kbps:.4g} per kbit/s meets every limit with the highest sum rate")
        return
    nearest = closest(tuning)
    ranges = "; ".join(f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in spread(tuning.rows).items())
    console.print(
        f"[red]no mu meets every limit:[/] at {nearest.mu_per_kbps:.4g} only {', '.join(nearest.missed)} is missed; "
        f"the scan reaches {ranges}",
        highlight=False,
    )


def _print(data: Any) -> None:
    write(json.dumps(data, indent=1), None)
