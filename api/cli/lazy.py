"""Commands that are imported when they are called: `skyfolio --help` loads neither the planner nor the service."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from skyfolio.api.cli.examples import epilog_of

COMPLETION = "_SKYFOLIO_COMPLETE"
"""Set in the environment when a shell asks what could come next (`completion.py`)."""


class LazyCommand(NamedTuple):
    """A command, or a group of commands, that has not been imported yet.

    target: `module:function` or `module:group`. help: what `--help` says of it, the first line of its docstring.
    solves: it runs the optimiser in this process, so the kernels are loaded before it starts and are not part of the
    times that it measures.
    """

    target: str
    help: str
    solves: bool = False


class Group(TyperGroup):
    """A group whose `--help` shows the first sentences of each command in full, on as many lines as they take."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of this name, or None when there is no such command."""
        command = super().get_command(ctx, cmd_name)
        if command is not None and command.help:
            command.short_help = " ".join(command.help.split("\n\n")[0].split())
        return command


class LazyGroup(TyperGroup):
    """A group whose commands are all in `commands_by_name`, and are imported when they are called."""

    commands_by_name: dict[str, LazyCommand]

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - as in the base class
        """Return all names, sorted."""
        return sorted(self.commands_by_name)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """Return what the group's `--help` needs to know of a command, or None when there is no such command."""
        command = self.commands_by_name.get(cmd_name)
        return None if command is None else TyperCommand(cmd_name, short_help=command.help)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the command that is called."""
        if args and args[0] in self.commands_by_name:
            return args[0], load(args[0], self.commands_by_name[args[0]]), args[1:]
        return super().resolve_command(ctx, args)


def application(help_text: str, group: type[TyperGroup] = Group) -> typer.Typer:
    """Return an empty group. Its help is plain text: loading what draws boxes takes as long as everything else."""
    return typer.Typer(
        cls=group,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help=help_text,
    )


def load(name: str, command: LazyCommand) -> Any:
    """Import the command."""
    module, attribute = command.target.split(":")
    target = getattr(import_module(module), attribute)
    if not isinstance(target, typer.Typer):
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        app.command(name)(target)
        target = app
    loaded = typer.main.get_command(target)
    _show_examples(name, loaded)
    if command.solves:
        loaded.callback = _with_kernels(loaded.callback)
    return loaded


def _show_examples(name: str, command: Any) -> None:
    """Put the examples of a command, or of all commands of a group, at the end of their help."""
    for part, of_group in getattr(command, "commands", {}).items():
        _show_examples(f"{name} {part}", of_group)
    command.epilog = epilog_of(name)


def _with_kernels(callback: Any) -> Any:
    def prepared(*arguments: Any, **options: Any) -> Any:
        from skyfolio.api.common import kernels  # noqa: PLC0415

        kernels.report_temporary_folder(print_error)
        kernels.load_all(print_error)
        return callback(*arguments, **options)

    return prepared


def print_error(line: str) -> None:
    """Print one line on standard error."""
    typer.echo(line, err=True)
