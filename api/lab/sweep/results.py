"""The results of a sweep read again: all rows, a summary by what was varied, plots."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from skyfolio.api.common import extras
from skyfolio.api.lab.plots import COLOURS, MARKERS, new_figure
from skyfolio.api.lab.sweep.parts import Parts, SweepError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from matplotlib.figure import Figure

SUMMED = (
    "utility_bps",
    "mean_sum_rate_bps",
    "sum_rate_variance_kbps2",
    "jain",
    "least_user_rate_bps",
    "gap",
    "solve_ms",
)
"""Measures of the summary."""
DRAWN = {
    "utility_bps": ("utility, kbit/s", 1e-3),
    "mean_sum_rate_bps": ("mean sum rate, kbit/s", 1e-3),
    "sum_rate_variance_kbps2": ("variance of the sum rate, (kbit/s)²", 1.0),
    "jain": ("Jain index", 1.0),
    "least_user_rate_bps": ("least user's mean rate, kbit/s", 1e-3),
}
"""Measures that are drawn, each with its label and what it is multiplied by."""
MOST_CURVES = 12
CURVES_OF_A_LIST = 8
"""An axis with more values than this is drawn along, not as one curve for each value."""


@overload
def load(folder: Path | str, *, kind: Literal["pandas"] = "pandas") -> pd.DataFrame: ...
@overload
def load(folder: Path | str, *, kind: Literal["arrow"]) -> pa.Table: ...


def load(folder: Path | str, *, kind: Literal["pandas", "arrow"] = "pandas") -> Any:
    """Return all rows of the sweep in this folder that are computed so far, by case, as a DataFrame or an Arrow table.

    Columns: `case`, each setting by its path, `status`, `error`, the measures with their units in their names, and
    `user_rates_bps`, the mean rate of each user. Lists among the settings are JSON text. Parts of other sweeps in the
    same folder are left out. Raises SweepError when no sweep is there or a part cannot be read, MissingExtraError.
    """
    extras.require_all("sweep", "reading a sweep")
    import pyarrow as pa  # noqa: PLC0415 - an extra
    import pyarrow.parquet as pq  # noqa: PLC0415

    parts = Parts(Path(folder))
    there = parts.there()
    files = [parts.path(address) for address in parts.description()["parts"] if address in there]
    if not files:
        raise SweepError(f"{folder}: no part of the sweep is computed yet")
    try:
        table = pa.concat_tables([pq.read_table(file, partitioning=None) for file in files])
    except (pa.ArrowException, OSError) as error:
        raise SweepError(f"{folder}: a part cannot be read: {error}; delete it, and start the sweep again") from error
    return table.to_pandas() if kind == "pandas" else table


def summary_of(folder: Path) -> pd.DataFrame:
    """Return mean and spread of each measure, for each combination of what was varied and is not averaged over.

    Cases without a plan count in `cases` but not in `planned`, and have no measures. What is drawn from an interval at
    random is averaged over, since no value comes twice.
    """
    rows = load(folder)
    by = _grouped(Parts(folder).description(), rows)
    rows["planned"] = rows["status"] != "refused"
    measures = {f"{name}_{how}": (name, how) for name in SUMMED for how in ("mean", "std")}
    groups = rows.groupby(by, dropna=False) if by else rows.assign(all=True).groupby("all")
    table = groups.agg(cases=("case", "size"), planned=("planned", "sum"), **measures)
    return table.reset_index(drop=not by)


def pictures(folder: Path) -> Iterator[tuple[str, Figure]]:
    """Yield a plot of each measure by its file stem: along the first varied number, a curve for each other group.

    Nothing is drawn when no number was varied. Raises MissingExtraError without matplotlib.
    """
    told, rows = Parts(folder).description(), load(folder)
    rows = rows[rows["status"] != "refused"]
    along = next((name for name in told["varied"] if name not in told["averaged"] and _is_number(rows[name])), None)
    if along is None or rows.empty:
        return
    others = [name for name in _grouped(told, rows) if name != along]
    for measure, (label, scale) in DRAWN.items():
        figure = new_figure(7.5, 4.4)
        axes = figure.add_subplot()
        groups = rows.groupby(others, dropna=False) if others else [((), rows)]
        for index, (key, group) in enumerate(groups):
            if index == MOST_CURVES:
                axes.set_title(f"the first {MOST_CURVES} of {len(groups)} groups")
                break
            _draw(axes, group, along, measure, scale, _label(others, key), index)
        axes.set(xlabel=along, ylabel=label)
        axes.grid(alpha=0.3)
        if others:
            axes.legend(fontsize=7)
        yield measure.removesuffix("_bps").removesuffix("_kbps2").replace("_", "-"), figure


def _draw(axes: Any, group: pd.DataFrame, along: str, measure: str, scale: float, label: str, index: int) -> None:
    """Draw the mean at each value and its spread; single points where hardly any value comes twice."""
    colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
    values = group.groupby(along)[measure]
    if values.ngroups > len(group) / 2 and len(group) > CURVES_OF_A_LIST * 4:
        axes.plot(group[along], group[measure] * scale, marker, color=colour, markersize=3, alpha=0.5, label=label)
        return
    mean, spread = values.mean() * scale, values.std().fillna(0.0) * scale
    axes.plot(mean.index, mean, color=colour, marker=marker, label=label)
    axes.fill_between(mean.index, mean - spread, mean + spread, color=colour, alpha=0.12, linewidth=0)


def _grouped(told: dict[str, Any], rows: pd.DataFrame) -> list[str]:
    """Return the varied settings that rows are grouped by: those that are not averaged over and have few values."""
    intervals = {name for name, axis in told["spec"]["vary"].items() if "between" in axis and axis["steps"] is None}
    kept = (name for name in told["varied"] if name not in told["averaged"] and name in rows.columns)
    return [name for name in kept if name not in intervals or told["spec"]["design"] == "grid"]


def _is_number(column: pd.Series) -> bool:
    return column.dtype.kind in "if" and column.nunique() > 1


def _label(names: list[str], key: Any) -> str:
    values = key if isinstance(key, tuple) else (key,)
    return ", ".join(f"{name.rpartition('.')[2]} {value}" for name, value in zip(names, values, strict=True))


def write_results(folder: Path) -> list[Path]:
    """Write the summary, and the plots where matplotlib is installed, into the folder. Return the files."""
    files = [folder / "summary.csv"]
    summary_of(folder).to_csv(files[0], index=False)
    if extras.installed("matplotlib"):
        for stem, figure in pictures(folder):
            files.append(folder / f"{stem}.svg")
            figure.savefig(files[-1], metadata={"Date": None})
    return files
