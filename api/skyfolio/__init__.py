"""Plan, fly and heal multi-UAV communication networks.

What is listed in `__all__` is the public API, described in docs/python.md: these names and what they do are kept from
one release to the next, or are deprecated for one before they change. Everything else may change at any time:

    skyfolio.planner         scenarios, utilities, plans, replans, certificates: numbers in, numbers out
    skyfolio.mavlink_bridge  plans as MAVLink missions, links, loss detection
    skyfolio.sim             a fleet in software that speaks MAVLink
    skyfolio.api             the service, its client, the command line, the dashboard

In the repository each of the four is a folder at the top; they are one package once installed.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

from skyfolio.api.common import kernels as _kernels

if TYPE_CHECKING:
    from skyfolio.api.client import ApiError, AsyncClient, Client
    from skyfolio.api.common.plugins import load_plugins
    from skyfolio.api.places.reading import read_scenario
    from skyfolio.planner import (
        EXAMPLES,
        METHODS,
        Changes,
        Channel,
        Comparison,
        Explanation,
        Origin,
        PinError,
        Pins,
        Plan,
        PlanArrays,
        ReplanError,
        Robustness,
        Scenario,
        Trial,
        Uav,
        UnreachableEndError,
        UnsuitedError,
        User,
        Utility,
        assess,
        explain,
        plan,
        preview,
        register_channel,
        register_method,
        register_utility,
        replan,
        violations,
    )

    __version__: str

__all__ = [
    "EXAMPLES",
    "METHODS",
    "ApiError",
    "AsyncClient",
    "Changes",
    "Channel",
    "Client",
    "Comparison",
    "Explanation",
    "Origin",
    "PinError",
    "Pins",
    "Plan",
    "PlanArrays",
    "ReplanError",
    "Robustness",
    "Scenario",
    "Trial",
    "Uav",
    "UnreachableEndError",
    "UnsuitedError",
    "User",
    "Utility",
    "__version__",
    "assess",
    "explain",
    "load_plugins",
    "plan",
    "preview",
    "read_scenario",
    "register_channel",
    "register_method",
    "register_utility",
    "replan",
    "violations",
]

_HOMES = {
    "ApiError": "skyfolio.api.client",
    "AsyncClient": "skyfolio.api.client",
    "Client": "skyfolio.api.client",
    "load_plugins": "skyfolio.api.common.plugins",
    "read_scenario": "skyfolio.api.places.reading",
}
"""Where public names live that are not the planner's."""

_kernels.choose_folder()  # before anything imports numba, in whatever process


def __getattr__(name: str) -> Any:
    """Load a public name from where it lives, when it is asked for. Raises AttributeError for any other name."""
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - 30 ms that `skyfolio --help` does not need

        return version("skyfolio")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(_HOMES.get(name, "skyfolio.planner")), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
