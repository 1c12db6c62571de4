"""What commands read and write: scenarios, plans, results; and the error for a user's mistake."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from pydantic import BaseModel

    from skyfolio.planner import Scenario

Model = TypeVar("Model", bound="BaseModel")
Json = Annotated[bool, typer.Option("--json", help="Print JSON only.")]
PinsFile = Annotated[
    Path | None, typer.Option("--pins", help="JSON of what the plan keeps: paths_m, uavs, associations.")
]
Out = Annotated[Path | None, typer.Option(help="Write the result here instead of printing it.")]


class UsageError(Exception):
    """The command line or a file given on it is wrong; exit status 2."""


def read_scenario(file: Path | None, example: str | None) -> Scenario:
    """Return the scenario in a file, or the example of this name. Raises UsageError."""
    from skyfolio.planner import EXAMPLES, Scenario  # noqa: PLC0415 - loaded only where a scenario is read

    if (file is None) == (example is None):
        raise UsageError("give a scenario FILE or --example NAME, one of them")
    if file is not None:
        return read_as(Scenario, file)
    if example not in EXAMPLES:
        raise UsageError(f"--example: {example!r} must be one of {', '.join(EXAMPLES)}")
    return EXAMPLES[example]()


def read_as(model: type[Model], file: Path) -> Model:
    """Return the JSON file as this model. Raises UsageError that names the file and each broken rule, one on a line."""
    from pydantic import ValidationError  # noqa: PLC0415 - loaded only where a model is read

    from skyfolio.api.common.plugins import load_plugins  # noqa: PLC0415
    from skyfolio.api.common.validation import broken_rules  # noqa: PLC0415

    load_plugins()
    try:
        return model.model_validate_json(read(file))
    except ValidationError as error:
        rows = broken_rules(error.errors(), ())
        raise UsageError("\n".join(f"{file}: {row['field']}: {row['message']}" for row in rows)) from error


def read(file: Path) -> str:
    """Return the text of a file, UTF-8 with or without a byte order mark. Raises UsageError."""
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{file}: {error}") from error


def write(text: str, out: Path | None) -> None:
    """Write into the file, creating its folder, or to standard output. Raises UsageError when it cannot be written."""
    if out is None:
        sys.stdout.write(text.rstrip("\n") + "\n")
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--out: {out}: {error.strerror or error}") from error
