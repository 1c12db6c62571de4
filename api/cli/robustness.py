"""`skyfolio robustness`: what a plan stands up to, without a service."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, Group
from rich.table import Table

from skyfolio.api.cli.files import Json, Out, read_as, write
from skyfolio.planner import Deadline, Disturbances, Losses, Plan, Robustness, Trial, assess

DEFAULT, LOSSES, TRIAL = Disturbances(), Losses(), Trial()


def robustness(
    file: Annotated[Path, typer.Argument(help="Plan as JSON, as `skyfolio plan --json` prints it.")],
    draws: Annotated[int, typer.Option(min=1, max=10_000, help="How often everything is drawn.")] = DEFAULT.draws,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="The same seed gives the same draws.")] = 0,
    fading: Annotated[bool, typer.Option(help="Draw the channel's fading.")] = True,
    wind_mps: Annotated[float, typer.Option(min=0, max=50, help="Mean speed of the wind, m/s.")] = DEFAULT.wind_mps,
    gust_mps: Annotated[float, typer.Option(min=0, max=50, help="Spread of gusts, each axis, m/s.")] = DEFAULT.gust_mps,
    noise_m: Annotated[
        float, typer.Option(min=0, max=1000, help="Spread of errors of position on each axis, metres.")
    ] = DEFAULT.position_noise_m,
    noise_s: Annotated[
        float, typer.Option(min=0.001, max=100_000, help="Time constant of errors of position, seconds.")
    ] = DEFAULT.position_noise_s,
    pushed_s: Annotated[
        float, typer.Option(min=0, max=10, help="Metres off its path that each m/s of wind pushes a UAV.")
    ] = DEFAULT.pushed_s,
    at_once: Annotated[int, typer.Option(min=0, max=2, help="Lose up to so many UAVs together.")] = LOSSES.at_once,
    at_slot: Annotated[list[int] | None, typer.Option(min=0, help="When they are lost; default: half way.")] = None,
    recovery_s: Annotated[
        float, typer.Option(min=0, max=600, help="Seconds from a loss until the new plan is flown.")
    ] = LOSSES.recovery_s,
    starts: Annotated[int, typer.Option(min=1, max=64, help="Starts of each replan.")] = LOSSES.starts,
    most: Annotated[
        int, typer.Option(min=0, max=10_000, help="Losses that are tried at most, single ones first.")
    ] = LOSSES.most,
    outage_share: Annotated[
        float, typer.Option(min=0.001, max=1, help="Less than this share of what is planned is an outage.")
    ] = TRIAL.outage_share,
    outage_kbps: Annotated[
        float | None, typer.Option(help="Less kbit/s in a slot is an outage; default: by minimum or planned rates.")
    ] = None,
    deadline_s: Annotated[
        float, typer.Option(min=0.001, help="Leave out what is not computed in so many seconds.")
    ] = 60.0,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Assess a plan: rates and outages under fading, wind and errors of position, and after every loss."""
    trial = Trial(
        disturbances=Disturbances(
            draws=draws,
            seed=seed,
            fading=fading,
            wind_mps=wind_mps,
            gust_mps=gust_mps,
            pushed_s=pushed_s,
            position_noise_m=noise_m,
            position_noise_s=noise_s,
        ),
        losses=Losses(at_once=at_once, at_slots=tuple(at_slot or ()), recovery_s=recovery_s, starts=starts, most=most),
        outage_share=outage_share,
        outage_bps=None if outage_kbps is None else outage_kbps * 1e3,
    )
    until = Deadline(deadline_s, clock=time.monotonic)
    found = assess(read_as(Plan, file), trial, stop=lambda: until([]))
    if as_json or out is not None:
        write(found.model_dump_json(indent=2), out)
    if not as_json:
        Console().print(tables(found))


def tables(found: Robustness) -> Group:
    """Return what was found as tables; rates in kbit/s."""
    said = f"{found.draws} draws; an outage is {found.outage}"
    return Group(_users(found), *([_losses(found)] if found.losses else []), said, *_worst(found), *found.notes)


def _users(found: Robustness) -> Table:
    table = Table("user", "planned", "5 %", "50 %", "95 %", "outage", title=found.plan_id)
    for user in found.users:
        rate = user.rate_bps
        numbers = (user.planned_bps, rate.p5_bps, rate.p50_bps, rate.p95_bps)
        table.add_row(user.user_id, *(f"{number / 1e3:.2f}" for number in numbers), _share(user.outage_probability))
    rate = found.sum_rate_bps
    numbers = (found.planned_sum_rate_bps, rate.p5_bps, rate.p50_bps, rate.p95_bps)
    table.add_row("all", *(f"{number / 1e3:.2f}" for number in numbers), _share(found.outage_probability), style="bold")
    return table


def _losses(found: Robustness) -> Table:
    table = Table(
        "lost", "at slot", "without replan", "with", "5 %", "outage", "cut off", title="From a loss on, kbit/s"
    )
    for loss in found.losses:
        numbers = (loss.without_replan_bps, loss.with_replan_bps, loss.rate_bps.p5_bps)
        shown = [f"{number / 1e3:.2f}" for number in numbers]
        cut_off = ", ".join(loss.cut_off) or "-"
        table.add_row(", ".join(loss.lost), str(loss.at_slot), *shown, _share(loss.outage_probability), cut_off)
    return table


def _worst(found: Robustness) -> list[str]:
    worst = found.worst
    lines = [f"worst draw: number {worst.draw}"]
    if worst.user_id is not None:
        lines.append(f"likeliest outage: {worst.user_id}")
    for what, number in (("loss", worst.single_loss), ("double loss", worst.double_loss)):
        if number is not None:
            lines.append(f"worst {what}: {', '.join(found.losses[number].lost)}")
    return lines


def _share(share: float | None) -> str:
    return "-" if share is None else f"{share:.1%}"
