"""Kinds of channels beside measurements: by how many decibels each is off, once one offset is taken out.

What transmitters send and antennas gain is seldom known as well as a model would need it: so a constant, the median of
what is measured over what the model says, is fitted to one half of the measurements, and errors are those of the other
half. The halves are blocks of rows in turn, since neighbouring rows of a flight are nearly the same measurement.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from io import StringIO
from typing import Any, NamedTuple, get_args

import numpy as np
from rich.table import Table

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels import aerial_3gpp, los_probability
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.channels.radio import RadioChannel

COLUMNS = ("away_m", "height_m", "gain_db")
BLOCKS = 20
"""Of rows, which are in one half and the other in turn."""
LEAST_ROWS = 2 * BLOCKS


class Links(NamedTuple):
    """Measured links: distances over ground, heights of the UAV over the other end, metres, and gains, dB."""

    away_m: Array
    height_m: Array
    gain_db: Array


def links_of(text: str) -> Links:
    """Return the links of a CSV with the columns of `COLUMNS`; others are not used.

    Raises ValueError that names row, column and rule.
    """
    reader = csv.DictReader(StringIO(text))
    missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise ValueError(f"it must have the columns {', '.join(COLUMNS)}; there is no {', '.join(missing)}")
    rows = [[_number(row, name, number) for name in COLUMNS] for number, row in enumerate(reader, start=2)]
    if len(rows) < LEAST_ROWS:
        raise ValueError(f"it has {len(rows)} measurements; at least {LEAST_ROWS} are needed")
    return Links(*np.array(rows).T)


def _number(row: Mapping[str, str | None], name: str, number: int) -> float:
    try:
        value = float(row[name] or "")
    except ValueError:
        raise ValueError(f"row {number}, {name}: {row[name]!r} is no number") from None
    if not np.isfinite(value) or (name == "away_m" and value < 0.0):
        raise ValueError(f"row {number}, {name}: {value:g} must be finite, and no distance below 0")
    return value


def models(carrier_hz: float) -> dict[str, RadioChannel]:
    """Return every kind in every environment at a carrier, by what it is called in the table."""
    given = {"rician (free space)": {"carrier_hz": carrier_hz}} | {
        f"{kind}, {environment}": {"kind": kind, "environment": environment, "carrier_hz": carrier_hz}
        for kind, environments in (
            ("los_probability", get_args(los_probability.Environment)),
            ("3gpp_uav", get_args(aerial_3gpp.Environment)),
        )
        for environment in environments
    }
    return {name: channel_of(fields) for name, fields in given.items()}


def errors_db(links: Links, channel: RadioChannel) -> tuple[float, Array]:
    """Return the offset that was fitted to one half of the links, and the errors of the other half, dB."""
    distance_m = np.hypot(links.away_m, links.height_m)
    height_m = channel.known_height_m(links.height_m)
    modelled_db = 10.0 * np.log10(channel.power_gain(links.away_m, np.maximum(distance_m, 1.0), height_m))
    return _halves(links.gain_db - modelled_db)


def _halves(over_db: Array) -> tuple[float, Array]:
    """Return the median of one half, and by how much the other half is off that."""
    fitted = np.arange(len(over_db)) * BLOCKS // len(over_db) % 2 == 0
    offset_db = float(np.median(over_db[fitted]))
    return offset_db, over_db[~fitted] - offset_db


def measured_figures(links: Links, carrier_hz: float) -> dict[str, Any]:
    """Return the errors of every model, and of none: the same gain everywhere."""
    rows = [_row("none: one gain everywhere", *_halves(links.gain_db))]
    rows += [_row(name, *errors_db(links, channel)) for name, channel in models(carrier_hz).items()]
    return {
        "links": len(links.gain_db),
        "carrier_hz": carrier_hz,
        "away_m": _span(links.away_m),
        "height_m": _span(links.height_m),
        "rows": rows,
    }


def _row(what: str, offset_db: float, error_db: Array) -> dict[str, Any]:
    size = np.abs(error_db)
    return {
        "what": what,
        "offset_db": offset_db,
        "median_db": float(np.median(size)),
        "p90_db": float(np.percentile(size, 90)),
    }


def _span(values: Array) -> list[float]:
    return [float(one) for one in np.percentile(values, [5, 95])]


def table(figures: Mapping[str, Any]) -> Table:
    """Return the errors as a table."""
    made = Table(title=f"{figures['links']} links at {figures['carrier_hz'] / 1e9:g} GHz")
    for column in ("channel", "offset, dB", "median error, dB", "90 % within, dB"):
        made.add_column(column, justify="left" if column == "channel" else "right")
    for cells in _cells(figures["rows"]):
        made.add_row(*cells)
    return made


def _cells(rows: Iterable[Mapping[str, Any]]) -> Iterable[tuple[str, ...]]:
    for row in rows:
        yield row["what"], f"{row['offset_db']:+.1f}", f"{row['median_db']:.1f}", f"{row['p90_db']:.1f}"
