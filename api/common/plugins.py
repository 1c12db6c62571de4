"""Methods, utilities and channels that installed packages add: entry points of the group `skyfolio.plugins`.

An entry point is a function without arguments that calls `register_channel`, `register_utility` or `register_method`,
or a module that does so when it is imported. They are loaded where programs begin: by the service and each of its
workers, by commands that read a scenario or plan, and in Python by `skyfolio.load_plugins()`.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from skyfolio.api.common.errors import ServiceError

GROUP = "skyfolio.plugins"


class PluginError(ServiceError):
    """An installed package cannot add what it offers."""


@cache
def load_plugins() -> tuple[str, ...]:
    """Load every plug-in, once in each process; return their names. Raises PluginError that names the first bad one."""
    loaded = []
    for offered in entry_points(group=GROUP):
        try:
            register = offered.load()
            if callable(register):
                register()
        except Exception as error:
            home = offered.dist.name if offered.dist else offered.value
            raise PluginError(f"plug-in {offered.name} of {home}: {type(error).__name__}: {error}") from error
        loaded.append(offered.name)
    return tuple(loaded)
