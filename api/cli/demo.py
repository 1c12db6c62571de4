"""`skyfolio demo`: the drill of the letter, flown by the service and a simulated fleet."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated, Literal

import typer

from skyfolio.api.cli.files import Json, read_as, write
from skyfolio.api.cli.lazy import print_error
from skyfolio.api.common import extras


def demo(
    file: Annotated[Path | None, typer.Argument(help="Own scenario as JSON; default: the letter's.")] = None,
    speedup: Annotated[float, typer.Option(min=1, max=20, help="Times real time.")] = 5.0,
    kill: Annotated[str | None, typer.Option(help="The UAV that crashes; default: one amid the list.")] = None,
    kill_slot: Annotated[
        int | None, typer.Option(min=2, help="It crashes when this slot begins; 1 is the first. Default: half way.")
    ] = None,
    replan: Annotated[
        bool, typer.Option("--replan/--no-replan", help="Whether the service recovers from the loss.")
    ] = True,
    utility: Annotated[
        Literal["sum", "per_user", "pooled"] | None,
        typer.Option(help="What the plans maximise; default: pooled, or what an own scenario says."),
    ] = None,
    mu: Annotated[
        float | None,
        typer.Option(
            max=0, help="1/(kbit/s): 0 is pure sum rate, more negative is steadier; default: -0.3, or as it says."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of report.html and report.json.")] = Path("out/demo"),
    as_json: Json = False,
) -> None:
    """Plan, fly, lose a UAV, replan, fly on, and check it all against the simulator's ground truth."""
    from skyfolio.api.lab.demo import DemoConfig, DemoError, run_demo  # noqa: PLC0415 - `--help` needs none of these
    from skyfolio.planner import Scenario  # noqa: PLC0415

    extras.require("matplotlib", "the report of the drill")
    scenario = read_as(Scenario, file) if file else DemoConfig().scenario
    worth = {"kind": utility, "mu_per_kbps": mu}
    given = {name: value for name, value in worth.items() if value is not None}
    scenario = scenario.with_changes(utility=scenario.utility.model_dump() | given)
    config = DemoConfig(
        scenario=scenario,
        speedup=speedup,
        kill=kill or scenario.uav_ids[len(scenario.uav_ids) // 2],
        kill_slot=kill_slot or scenario.slots // 2 + 1,
        replan=replan,
        out=out,
    )
    try:
        report = asyncio.run(run_demo(config, quiet=as_json))
    except DemoError as error:
        print_error(f"the drill was not flown: {error}")
        raise typer.Exit(1) from error
    if as_json:
        write(report.model_dump_json(indent=2), None)
    raise typer.Exit(0 if report.passed else 1)
