"""The one form of an error: `error: FILE or --option: field: rule`, one a line, on standard error."""

from __future__ import annotations

import sys
from typing import Any

USER_ERRORS = {
    "skyfolio.api.cli.files": "UsageError",
    "skyfolio.api.common.errors": "ServiceError",
    "skyfolio.api.store.errors": "StoreError",
    "skyfolio.mavlink_bridge.errors": "BridgeError",
    "skyfolio.planner.changes": "ReplanError",
    "skyfolio.planner.pinning": "PinError",
    "skyfolio.planner.robustness.findings": "RobustnessError",
    "skyfolio.planner.unreachable": "UnreachableEndError",
    "skyfolio.planner.unsuited": "UnsuitedError",
}
"""Errors that a user can act on, by the module that defines them: a module that is not loaded has raised none."""


def messages(error: Exception) -> list[str]:
    """Return the messages for the user, one a line; nothing when the error is not the user's mistake."""
    if hasattr(error, "format_message"):
        return [_of_command_line(error)]
    pydantic = sys.modules.get("pydantic")
    if pydantic is not None and isinstance(error, pydantic.ValidationError):
        from skyfolio.api.common.validation import broken_rules  # noqa: PLC0415

        return [f"{row['field']}: {row['message']}" for row in broken_rules(error.errors(), ())]
    kinds = tuple(getattr(sys.modules[home], name) for home, name in USER_ERRORS.items() if home in sys.modules)
    return str(error).splitlines() if isinstance(error, kinds) else []


def is_help(error: Exception) -> bool:
    """Return whether this is no error, but the help of a group of commands that was called without one."""
    return type(error).__name__ == "NoArgsIsHelpError"


def _of_command_line(error: Any) -> str:
    """Return what the parser of the command line says, with the option or argument first, and where to look."""
    param, option = getattr(error, "param", None), getattr(error, "option_name", None)
    said = str(error.message or error.format_message()).rstrip(".")
    if param is not None:
        name = param.opts[0] if param.opts[0].startswith("-") else str(param.name).upper()
        said = f"{name}: {said}" if error.message else f"{name}: is missing"
    elif option is not None:
        said = f"{option}: there is no such option" if hasattr(error, "possibilities") else f"{option}: {said}"
    where = getattr(error, "ctx", None)
    return said if where is None else f"{said}; see {where.command_path} --help"
