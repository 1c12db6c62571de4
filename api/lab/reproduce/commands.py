"""`skyfolio reproduce` and `skyfolio tune-mu`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from skyfolio.api.lab.reproduce import figures
from skyfolio.api.lab.reproduce.batch import Advance, Batch
from skyfolio.api.lab.reproduce.calibration import calibrate
from skyfolio.api.lab.reproduce.courses import Choices
from skyfolio.api.lab.reproduce.document import document
from skyfolio.api.lab.reproduce.study import StudyConfig, run_study, write
from skyfolio.api.lab.reproduce.tuning import Limits, Tuning, closest, spread, tune
from skyfolio.planner import EXAMPLES, Scenario

console = Console(stderr=True)
CALIBRATION_LAYOUTS = 4
Json = Annotated[bool, typer.Option("--json", help="Print JSON only.")]


def reproduce(
    figure: Annotated[Literal["2", "3", "5a", "5b", "all"], typer.Option(help="Which figure of the letter.")] = "all",
    out: Annotated[Path, typer.Option(help="Folder of reproduction.md and its pictures.")] = Path("out"),
    layouts: Annotated[int | None, typer.Option(min=2, help="User layouts; each UAV fails in turn in each.")] = None,
    draws: Annotated[int, typer.Option(min=1, help="Draws of the fading that are averaged.")] = Choices.draws,
    search: Annotated[bool, typer.Option("--calibrate", help="Search what the letter omits instead.")] = False,
    as_json: Json = False,
) -> None:
    """Compute the letter's figures and numbers and set them beside the printed ones.

    The write-up takes in what `--calibrate` has left in the same folder.
    """
    kept = out / "reproduction" / "calibration.json"
    if search:
        _calibrate(kept, layouts or CALIBRATION_LAYOUTS, as_json=as_json)
        return
    config = StudyConfig(figure=figure, layouts=layouts or StudyConfig.layouts, draws=draws)
    calibration = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else None
    with progress(f"figure {figure}", quiet=as_json) as advance:
        study = run_study(config, advance, calibration)
    written = write(study, out, document)
    if as_json:
        _print(study)
        return
    if "claims" in study:
        console.print(claims_table(study))
    console.print("written: " + ", ".join(str(path) for path in written), highlight=False)


def _calibrate(kept: Path, layouts: int, *, as_json: bool) -> None:
    with progress("calibrating", quiet=as_json) as advance, Batch(advance) as batch:
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
    scenario = Scenario.model_validate_json(file.read_text(encoding="utf-8")) if file else EXAMPLES["paper"]()
    limits = Limits(min_sum_rate_kbps=min_sum_rate, max_variance_kbps2=max_variance, min_jain=min_jain)
    with progress("scanning mu", quiet=as_json) as advance:
        found = tune(
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
            [row.model_dump() for row in found.rows if row.mu_per_kbps < 0], found.chosen_mu_per_kbps
        ).savefig(plot)
    if as_json:
        _print(found.model_dump(mode="json"))
    else:
        _show(found)
    raise typer.Exit(0 if found.chosen_mu_per_kbps is not None else 1)


@contextmanager
def progress(what: str, *, quiet: bool) -> Iterator[Advance]:
    """A bar on standard error that `advance(done, of)` moves."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=quiet) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def claims_table(study: dict[str, Any]) -> Table:
    """The verdicts for the eye."""
    shown = Table(
        "fig.", "claim", "letter", "ours", "verdict", title=f"{study['cases']} cases, {study['seconds']:.0f} s"
    )
    colours = {"reproduced": "green", "trend only": "yellow", "open": "cyan", "not reproducible": "red"}
    for one in study["claims"]:
        paper = "-" if one["paper"] is None else f"{one['paper']:.4g}"
        ours = f"{one['ours']:.4g}" + ("" if one["half"] is None else f" ± {one['half']:.2g}")
        verdict = f"[{colours[one['verdict']]}]{one['verdict']}[/]"
        shown.add_row(one["figure"], one["claim"], paper, f"{ours} {one['unit']}", verdict)
    return shown


def _show(found: Tuning) -> None:
    shown = Table("mu, 1/(kbit/s)", "sum rate, kbit/s", "variance, (kbit/s)²", "Jain", "limits missed")
    for row in found.rows:
        mark = "bold green" if row.mu_per_kbps == found.chosen_mu_per_kbps else ""
        shown.add_row(
            f"{row.mu_per_kbps:.4g}",
            f"{row.mean_sum_rate_kbps:.2f}",
            f"{row.variance_kbps2:.2f}",
            f"{row.jain:.3f}",
            ", ".join(row.missed) or "none",
            style=mark,
        )
    console.print(shown)
    if found.chosen_mu_per_kbps is not None:
        console.print(f"mu = {found.chosen_mu_per_kbps:.4g} per kbit/s meets every limit with the highest sum rate")
        return
    nearest = closest(found)
    ranges = "; ".join(f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in spread(found.rows).items())
    console.print(
        f"[red]no mu meets every limit:[/] at {nearest.mu_per_kbps:.4g} only {', '.join(nearest.missed)} is missed; "
        f"the scan reaches {ranges}",
        highlight=False,
    )


def _print(data: Any) -> None:
    sys.stdout.write(json.dumps(data, indent=1) + "\n")
