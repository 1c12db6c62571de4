"""Commands that plan, prove and export by themselves, without a service."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console

from skyfolio.api.cli import terminal as show
from skyfolio.api.cli.autopilots import DEFAULT, AutopilotOfMission
from skyfolio.api.cli.files import Json, Out, PinsFile, UsageError, read, read_as, read_scenario, write
from skyfolio.api.cli.progress import planning, proving
from skyfolio.planner import (
    EXAMPLES,
    METHODS,
    AnyOf,
    Changes,
    Deadline,
    Pins,
    Plan,
    Scenario,
    converged,
    plan,
    replan,
)
from skyfolio.planner.methods import DEFAULT_METHOD
from skyfolio.planner.utilities import UTILITIES

if TYPE_CHECKING:
    from skyfolio.api.places.writing import Format

UNMET_STATUS = 3
"""Exit status of a plan that could not give every user its minimum rate: it was written, and flies."""

DeadlineS = Annotated[float | None, typer.Option(min=0.001, help="Return the best plan after this many seconds.")]
ScenarioFile = Annotated[Path | None, typer.Argument(help="Scenario as JSON.")]
Example = Annotated[str | None, typer.Option(help=f"A ready scenario: {', '.join(EXAMPLES)}.")]


def plan_command(
    file: ScenarioFile = None,
    example: Example = None,
    method: Annotated[str, typer.Option(help=f"How to plan: {', '.join(METHODS)}.")] = DEFAULT_METHOD,
    utility: Annotated[
        str | None, typer.Option(help=f"What to maximise, instead of the scenario's: {', '.join(UTILITIES)}.")
    ] = None,
    mu: Annotated[
        float | None, typer.Option(max=0, help="Trade-off instead of the scenario's, 1/(kbit/s): 0 is pure sum rate.")
    ] = None,
    noise_dbm: Annotated[
        float | None, typer.Option(help="Noise at users instead of the scenario's, dBm; usually -120 to -60.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts that are drawn; the same seed plans the same.")] = 0,
    starts: Annotated[
        int | None, typer.Option(min=1, help="Starts that the search climbs from; default: by size of the scenario.")
    ] = None,
    pins: PinsFile = None,
    deadline_s: DeadlineS = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Plan a scenario."""
    scenario = _changed(read_scenario(file, example), utility=utility, mu=mu, noise_dbm=noise_dbm)
    kept = read_as(Pins, pins) if pins else None
    stop = _stop(deadline_s)
    with planning(scenario, stop) as options:
        asked: dict[str, Any] = {"method": method, "n_starts": starts, "seed": seed, "pins": kept}
        made = plan(scenario, stop=stop, clock=time.perf_counter, **asked, **options)
    _deliver(made, out, as_json)


def _changed(scenario: Scenario, *, utility: str | None, mu: float | None, noise_dbm: float | None) -> Scenario:
    """Return the scenario with what the command line gives instead. Raises pydantic's error of fields."""
    worth = {"kind": utility, "mu_per_kbps": mu}
    changes: dict[str, Any] = {}
    if given := {name: value for name, value in worth.items() if value is not None}:
        changes["utility"] = scenario.utility.model_dump() | given
    if noise_dbm is not None:
        changes["channel"] = scenario.channel.model_dump() | {"noise_dbm": noise_dbm}
    return scenario.with_changes(**changes)


def replan_command(
    file: Annotated[Path, typer.Argument(help="Plan as JSON, as `skyfolio plan --json` prints it.")],
    at_slot: Annotated[int, typer.Option(min=0, help="First slot to plan, counted from 0.")],
    failed: Annotated[list[str] | None, typer.Option(help="A UAV that is lost; may be given several times.")] = None,
    changes: Annotated[
        Path | None,
        typer.Option(
            help="JSON of what else is different: failed, returned, users_joined, users_left, utility, bandwidth_hz."
        ),
    ] = None,
    pins: PinsFile = None,
    keep_pins: Annotated[bool, typer.Option(help="Keep the pins of the plan too, as far as they hold.")] = False,
    disruption_weight: Annotated[
        float,
        typer.Option(
            min=0,
            help="kbit/s that a change must be worth: a user's other UAV throughout, or 100 m off the old paths.",
        ),
    ] = 0.0,
    deadline_s: DeadlineS = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Plan the remaining slots of a plan: for the survivors, and for what else is different."""
    previous = read_as(Plan, file)
    changed = read_as(Changes, changes) if changes else None
    if not failed and changed is None and pins is None:
        raise UsageError("give --failed UAV or --changes FILE, or --pins FILE: what is different?")
    stop = _stop(deadline_s)
    with planning(previous.scenario, stop) as options:
        replanned = replan(
            previous,
            failed=failed or (),
            at_slot=at_slot,
            changes=changed,
            pins=read_as(Pins, pins) if pins else None,
            keep_pins=keep_pins,
            disruption_weight=disruption_weight,
            stop=stop,
            clock=time.perf_counter,
            **options,
        )
    _deliver(replanned, out, as_json)


def export(
    file: Annotated[Path, typer.Argument(help="Plan as JSON; for geojson, kml and csv a scenario too.")],
    uav_id: Annotated[str | None, typer.Option(help="Which UAV; for --format plan and waypoints.")] = None,
    format: Annotated[  # noqa: A002
        Literal["plan", "waypoints", "json", "geojson", "kml", "csv"],
        typer.Option(
            help="File format: a mission of one UAV (plan, waypoints), all missions (json), or a map or table."
        ),
    ] = "plan",
    autopilot: AutopilotOfMission = DEFAULT,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Write a plan as QGroundControl `.plan`, `.waypoints` or JSON missions, or as GeoJSON, KML or CSV.

    CSV is a row for each slot and UAV. A scenario instead of a plan is written so that `skyfolio import` reads it back.
    """
    if format in {"geojson", "kml", "csv"} and not as_json:
        write(_places(file, format), out)
        return
    from skyfolio.api.plans.mission_files import Missions  # noqa: PLC0415 - MAVSDK is only loaded where it is used
    from skyfolio.mavlink_bridge import Autopilot  # noqa: PLC0415

    missions = Missions(read_as(Plan, file), Autopilot(autopilot))
    if format == "json" or as_json:
        text = json.dumps(missions.as_json(uav_id), indent=2)
    elif format == "plan":
        text = json.dumps(missions.qgc_plan(uav_id), indent=4)
    else:
        text = missions.waypoints(uav_id)
    write(text, out)


def _places(file: Path, form: Format) -> str:
    from skyfolio.api.places.writing import write_plan, write_scenario  # noqa: PLC0415 - not part of planning

    is_plan = '"trajectories_m"' in read(file)
    return write_plan(read_as(Plan, file), form) if is_plan else write_scenario(read_as(Scenario, file), form)


def bound(
    file: ScenarioFile = None,
    example: Example = None,
    tolerance: Annotated[float, typer.Option(min=1e-6, max=1, help="Relative gap at which a slot is settled.")] = 0.005,
    seconds: Annotated[
        float, typer.Option(min=0.001, help="Stop proving after so many seconds; the bound holds.")
    ] = 60.0,
    as_json: Json = False,
) -> None:
    """Plan a scenario of any size and prove how good the plan is: as tightly as the seconds allow."""
    from skyfolio.api.plans.certificate import certify, shown  # noqa: PLC0415
    from skyfolio.planner.certificate import UnprovableError  # noqa: PLC0415

    scenario = read_scenario(file, example)
    try:
        with proving(seconds) as told:
            figures = certify(scenario, tolerance=tolerance, seconds=seconds, told=told)
    except UnprovableError as error:
        raise UsageError(str(error)) from None
    if as_json:
        write(json.dumps(figures, indent=2), None)
    else:
        Console().print(shown(figures), highlight=False)


def _stop(deadline_s: float | None) -> AnyOf:
    if deadline_s is None:
        return converged()
    return AnyOf(converged(), Deadline(deadline_s, clock=time.monotonic))


def _deliver(result: Plan, out: Path | None, as_json: bool) -> None:
    if as_json or out is not None:
        write(result.model_dump_json(indent=2), out)
    if not as_json:
        Console().print(show.plan_table(result))
    if result.unmet_min_rate_slots:
        for line in show.unmet(result):
            Console(stderr=True).print(f"[yellow]not served:[/] {line}", highlight=False, soft_wrap=True)
        raise typer.Exit(UNMET_STATUS)
