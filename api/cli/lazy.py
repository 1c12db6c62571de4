"""Commands that are imported when they are called: `skyfolio --help` loads neither the planner nor the service."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup


class Later(NamedTuple):
    """Where a command is, `module:function` or `module:group`, and what `--help` says: its docstring's first line.

    solves: it runs the optimiser in this process, so kernels are there before it begins, and its times are of solving.
    """

    home: str
    help: str
    solves: bool = False


class LaterGroup(TyperGroup):
    """A group whose commands in `later` are imported when they are called; others are registered as ever."""

    later: dict[str, Later]

    def list_commands(self, ctx: Any) -> list[str]:
        """All names, sorted."""
        return sorted({*super().list_commands(ctx), *self.later})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """What `--help` needs to know of the command."""
        if cmd_name in self.later:
            return TyperCommand(cmd_name, help=self.later[cmd_name].help)
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is called, imported now."""
        if args and args[0] in self.later:
            return args[0], load(args[0], self.later[args[0]]), args[1:]
        return super().resolve_command(ctx, args)


def load(name: str, later: Later) -> Any:
    """Import the command."""
    module, attribute = later.home.split(":")
    found = getattr(import_module(module), attribute)
    if not isinstance(found, typer.Typer):
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command(name)(found)
        found = app
    command = typer.main.get_command(found)
    if later.solves:
        command.callback = _with_kernels(command.callback)
    return command


def _with_kernels(callback: Any) -> Any:
    def prepared(*given: Any, **named: Any) -> Any:
        from skyfolio.api.common import kernels  # noqa: PLC0415

        kernels.explain(typer_err)
        kernels.prepare(typer_err)
        return callback(*given, **named)

    return prepared


def typer_err(text: str) -> None:
    """One line on standard error."""
    typer.echo(text, err=True)
