"""The `skyfolio` command.

Every command takes `--json`, and then prints nothing but JSON on standard output.
"""

from __future__ import annotations

import sys

import typer

from skyfolio.api.cli.lazy import LazyCommand, LazyGroup, application

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
    "fleet": LazyCommand(f"{CLI}.remote:fleet", "Order vehicles of a service to hold, return or land now."),
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
    "status": LazyCommand(f"{CLI}.remote:status", "Show the state of an operation and of each of its UAVs."),
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
USER_ERRORS = {
    "skyfolio.api.cli.files": "UsageError",
    "skyfolio.api.common.errors": "ServiceError",
    "skyfolio.api.store.errors": "StoreError",
    "skyfolio.mavlink_bridge.errors": "BridgeError",
    "skyfolio.planner.changes": "ReplanError",
    "skyfolio.planner.pinning": "PinError",
    "skyfolio.planner.robustness.findings": "RobustnessError",
    "skyfolio.planner.unreachable": "UnreachableEndError",
}
"""Errors that a user can act on, by the module that defines them: a module that is not loaded has raised none."""


class Commands(LazyGroup):
    """All commands of `skyfolio`."""

    commands_by_name = COMMANDS


cli = application(__doc__ or "", Commands)


@cli.callback()
def _no_options() -> None:
    """Take no options: each belongs to a command."""


def main() -> None:
    """Run the command; errors a user can act on are one message on standard error and exit status 2."""
    try:
        cli()
    except Exception as error:
        lines = _messages(error)
        if not lines:
            raise
        for line in lines:
            typer.secho("error: ", fg="red", err=True, nl=False)
            typer.echo(line, err=True)
        sys.exit(2)


def _messages(error: Exception) -> list[str]:
    """Return the messages for the user, one a line; nothing when the error is not the user's mistake."""
    pydantic = sys.modules.get("pydantic")
    if pydantic is not None and isinstance(error, pydantic.ValidationError):
        from skyfolio.api.common.validation import broken_rules  # noqa: PLC0415

        return [f"{row['field']}: {row['message']}" for row in broken_rules(error.errors(), ())]
    kinds = tuple(getattr(sys.modules[home], name) for home, name in USER_ERRORS.items() if home in sys.modules)
    return str(error).splitlines() if isinstance(error, kinds) else []
