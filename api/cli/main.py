"""Plan, fly and heal multi-UAV communication networks.

Every command that prints a result takes `--json`, and then prints nothing but JSON on standard output. Exit status: 0;
1 when the answer is no (a drill failed, a vehicle disobeyed); 2 for a mistake in the command line or a file; 3 for a
plan that misses a minimum rate, and for a service that could not start; 130 when interrupted.
"""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from skyfolio.api.cli.lazy import COMPLETION, LazyCommand, LazyGroup, application
from skyfolio.api.cli.mistakes import is_help, messages

CLI = "skyfolio.api.cli"
COMMANDS = {
    "bench": LazyCommand(f"{CLI}.bench:bench", "Measure this machine; figures as JSON."),
    "bound": LazyCommand(
        f"{CLI}.planning:bound",
        "Plan a scenario of any size and prove how good the plan is: as tightly as the seconds allow.",
        solves=True,
    ),
    "check": LazyCommand(
        f"{CLI}.check:check",
        "Check vehicles on the ground: audit them, and try what is put on board; then restore what was there.",
    ),
    "completion": LazyCommand(
        f"{CLI}.completion:completion",
        "Print the completion script of a shell: source it, or put it where the shell looks for such scripts.",
    ),
    "demo": LazyCommand(
        f"{CLI}.demo:demo",
        "Plan, fly, lose a UAV, replan, fly on, and check it all against the simulator's ground truth.",
    ),
    "drill": LazyCommand(f"{CLI}.remote:drill", "Inject a fault into a simulated vehicle, to see the service recover."),
    "explain": LazyCommand(
        f"{CLI}.explain:explain_command",
        "Explain a plan: why users get little, what one thing more would be worth, and which constraint binds.",
        solves=True,
    ),
    "export": LazyCommand(
        f"{CLI}.planning:export",
        "Write a plan as QGroundControl `.plan`, `.waypoints` or JSON missions, or as GeoJSON, KML or CSV.",
    ),
    "fleet": LazyCommand(f"{CLI}.fleet:fleet", "Register and list the vehicles of a service, and order them."),
    "fly": LazyCommand(
        f"{CLI}.remote:fly", "Plan a scenario at the service and fly it with the vehicles registered there."
    ),
    "import": LazyCommand(
        f"{CLI}.importing:import_command",
        "Make a scenario of users, UAVs, no-fly zones, areas and rally points in GeoJSON, CSV or KML files.",
    ),
    "keys": LazyCommand(f"{CLI}.keys:keys", "Create, list and revoke the API keys of the service."),
    "plan": LazyCommand(f"{CLI}.planning:plan_command", "Plan a scenario.", solves=True),
    "replan": LazyCommand(
        f"{CLI}.planning:replan_command",
        "Plan the remaining slots of a plan: for the survivors, and for what else is different.",
        solves=True,
    ),
    "reproduce": LazyCommand(
        f"{CLI}.reproduce:reproduce",
        "Compute the letter's figures and numbers and set them beside the printed ones.",
        solves=True,
    ),
    "robustness": LazyCommand(
        f"{CLI}.robustness:robustness",
        "Assess a plan: rates and outages under fading, wind and errors of position, and after every loss.",
        solves=True,
    ),
    "serve": LazyCommand(
        f"{CLI}.serve:serve", "Run the service. Settings also come from SKYFOLIO_* environment variables."
    ),
    "simulate": LazyCommand(
        f"{CLI}.simulate:simulate", "Fly a software-only fleet that speaks MAVLink, until interrupted."
    ),
    "status": LazyCommand(
        f"{CLI}.remote:status", "Show the state of an operation and of each of its UAVs, with the reasons."
    ),
    "sweep": LazyCommand(
        f"{CLI}.sweep:sweep", "Plan thousands of scenarios, as a TOML file asks, on all cores or on a Dask cluster."
    ),
    "torture": LazyCommand(
        f"{CLI}.torture:torture",
        "Fly random drills in virtual time, and look at what must hold whatever happens.",
        solves=True,
    ),
    "tune-mu": LazyCommand(
        f"{CLI}.reproduce:tune_mu",
        "Find the mu that meets limits on sum rate, fluctuation and fairness, in the worst of the given losses.",
        solves=True,
    ),
    "warm-up": LazyCommand(
        f"{CLI}.warm_up:warm_up", "Compile the optimiser's kernels now, so that no later command has to."
    ),
}


class Commands(LazyGroup):
    """All commands of `skyfolio`."""

    commands_by_name = COMMANDS


cli = application(__doc__ or "", Commands)


def _show_version(wanted: bool) -> None:
    if wanted:
        from skyfolio import __version__  # noqa: PLC0415 - read when it is asked for

        typer.echo(f"skyfolio {__version__}")
        raise typer.Exit


Version = Annotated[bool, typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True)]


@cli.callback()
def _options(version: Version = False) -> None:
    """Take the options that belong to no command."""


def main() -> None:
    """Run the command; errors a user can act on are one message each on standard error and exit status 2."""
    if COMPLETION in os.environ:
        from typer.completion import completion_init  # type: ignore[attr-defined]  # noqa: PLC0415

        completion_init()
    try:
        sys.exit(cli(standalone_mode=False, complete_var=COMPLETION) or 0)
    except typer.Abort:
        typer.echo("aborted", err=True)
        sys.exit(1)
    except Exception as error:
        if is_help(error):
            typer.echo(str(error), err=True)
            sys.exit(2)
        lines = messages(error)
        if not lines:
            raise
        for line in lines:
            typer.secho("error: ", fg="red", err=True, nl=False)
            typer.echo(line, err=True)
        sys.exit(2)
