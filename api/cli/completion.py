"""`skyfolio completion`: the script that lets a shell complete commands, options and their values."""

from __future__ import annotations

from typing import Annotated, Literal

import typer
from typer.completion import get_completion_script  # type: ignore[attr-defined]

from skyfolio.api.cli.files import write
from skyfolio.api.cli.lazy import COMPLETION


def completion(
    shell: Annotated[Literal["bash", "zsh", "fish", "powershell"], typer.Argument(help="Which shell.")],
) -> None:
    """Print the completion script of a shell: source it, or put it where the shell looks for such scripts."""
    write(get_completion_script(prog_name="skyfolio", complete_var=COMPLETION, shell=shell), None)
