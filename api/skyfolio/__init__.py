"""Plan, fly and heal multi-UAV communication networks.

    skyfolio.planner         scenarios, utilities, plans, replans, certificates: numbers in, numbers out
    skyfolio.mavlink_bridge  plans as MAVLink missions, links, loss detection
    skyfolio.sim             a fleet in software that speaks MAVLink
    skyfolio.api             the service, its client, the command line, the dashboard

In the repository each of the four is a folder at the top; they are one package once installed.
"""

from typing import TYPE_CHECKING

from skyfolio.api.common import kernels

if TYPE_CHECKING:
    __version__: str

kernels.choose_folder()  # before anything imports numba, in whatever process


def __getattr__(name: str) -> str:
    """Return `__version__`, read when it is asked for. Raises AttributeError for any other name."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version  # noqa: PLC0415 - 30 ms that `skyfolio --help` does not need

    return version("skyfolio")
