"""The service: holds the optimiser, flies its plans with a fleet, and closes the loop when an aircraft is lost.

    routes/ <- gate (keys, limits, audit)           parse, call, render; errors leave through `problems`
    plan_book, solver -> solving, contingencies     plans, worker processes, plans made ahead of a loss
    fleet, take_off, flight, operation(s)           vehicles, the way into slot 0, one flight, operations
    guidance, streaming, given                      keepers or a stream, its guard, what each vehicle was given
    incidents, resilience, swapping, transition     what happens in flight and how it is answered
    journal, reattach, store/, events               what is kept, and how a restart goes on with it
    client, cli, remote_cli, keys_cli               ways in; `demo/` is the drill, `bench/` what measures all of this
    kernels                                         where the optimiser's compiled code is kept

`service.py` puts the parts together, `app.py` the routes. A step that reaches a vehicle is in the journal before it is
sent: whoever adds one keeps to that, and adds it to the kill matrix in the tests.
"""

from typing import TYPE_CHECKING

from api import kernels

if TYPE_CHECKING:
    __version__: str

kernels.settle()  # before anything imports numba, in whatever process


def __getattr__(name: str) -> str:
    """`__version__`, read when it is asked for. Raises AttributeError for any other name."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version  # noqa: PLC0415 - 30 ms that `skyfolio --help` does not need

    return version("skyfolio")
