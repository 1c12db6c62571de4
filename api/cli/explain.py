"""`skyfolio explain`: why a plan is as it is, without a service."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, Group
from rich.table import Table

from skyfolio.api.cli.files import Json, Out, read_as, write
from skyfolio.planner import Budget, Deadline, Explanation, Plan, explain

LEVELS = {"satisfied": "all it asked for"}
"""Levels that have other names in the table."""
PER = {"hertz": "a hertz", "m/s": "1 m/s", "lifted": "without it"}


def explain_command(
    file: Annotated[Path, typer.Argument(help="Plan as JSON, as `skyfolio plan --json` prints it.")],
    resolves: Annotated[
        int, typer.Option(min=0, help="Changed scenarios to solve at most; 0: bounds and derivatives only.")
    ] = Budget.most_resolves,
    starts: Annotated[int, typer.Option(min=1, help="Starts of each resolve.")] = Budget.starts,
    deadline_s: Annotated[
        float, typer.Option(min=0.001, help="Begin no further resolve after so many seconds.")
    ] = 60.0,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Explain a plan: why users get little, what one thing more would be worth, and which constraint binds."""
    until = Deadline(deadline_s, clock=time.monotonic)
    budget = Budget(most_resolves=resolves, starts=starts)
    found = explain(read_as(Plan, file), budget=budget, stop=lambda: until([]))
    if as_json or out is not None:
        write(found.model_dump_json(indent=2), out)
    if not as_json:
        Console().print(tables(found))


def tables(found: Explanation) -> Group:
    """Return an explanation as tables; rates and utilities in kbit/s."""
    return Group(_users(found), _worths(found), _constraints(found), *found.notes)


def _users(found: Explanation) -> Table:
    table = Table("user", "mean rate", "has", "because of", "how", "would have", "that is", title=found.plan_id)
    for row in found.users:
        mean = f"{row.mean_rate_bps / 1e3:.2f}"
        if row.main is None:
            table.add_row(row.user_id, mean, LEVELS.get(row.level, row.level))
            continue
        reason = next((one for one in row.reasons if one.kind == row.main), None)
        said = ("", "", "") if reason is None else (reason.method, f"{reason.rate_bps / 1e3:.2f}", reason.detail)
        table.add_row(row.user_id, mean, row.level, row.main, *said)
    return table


def _worths(found: Explanation) -> Table:
    table = Table("what", "UAV", "utility", "sum rate", "how", "that is", title="What it would be worth, kbit/s")
    for row in sorted(found.worth, key=lambda one: (one.what, one.uav_id, one.method)):
        rate = "-" if row.mean_sum_rate_gain_bps is None else f"{row.mean_sum_rate_gain_bps / 1e3:+.3f}"
        gain = f"{row.utility_gain_bps / 1e3:+.3f}"
        table.add_row(row.what.replace("_", " "), row.uav_id, gain, rate, row.method, row.detail)
    return table


def _constraints(found: Explanation) -> Table:
    table = Table("constraint", "binds at", "slots", "utility, bit/s", "for", "how", title="Which constraints bind")
    for row in found.constraints:
        price = "-" if row.price_bps is None else f"{row.price_bps:+.3f}"
        binds = ", ".join(row.uav_ids) or "-"
        table.add_row(row.constraint.replace("_", " "), binds, str(row.slots), price, PER[row.per], row.method)
    return table
