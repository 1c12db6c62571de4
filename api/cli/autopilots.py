"""The `--autopilot` option. The known names are read from the bridge when one is given, and not before."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

DEFAULT = "px4"
_HELP = "; an unknown name is answered with the known ones."


def _known_name(name: str) -> str:
    """Return the name of an autopilot that the bridge has a profile of; any other ends the command."""
    from skyfolio.mavlink_bridge import Autopilot  # noqa: PLC0415 - MAVSDK is only loaded where it is used

    try:
        return Autopilot(name).value
    except ValueError as unknown:
        raise typer.BadParameter(str(unknown)) from None


AutopilotOfFleet: TypeAlias = Annotated[
    str, typer.Option("--autopilot", metavar="NAME", parser=_known_name, help=f"Which autopilot they have{_HELP}")
]
AutopilotOfMission: TypeAlias = Annotated[
    str, typer.Option("--autopilot", metavar="NAME", parser=_known_name, help=f"Which autopilot will fly it{_HELP}")
]
