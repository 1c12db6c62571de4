"""The first moments of `skyfolio serve`: the worker of flights loads while this process imports the rest."""

from __future__ import annotations

import signal
import sys
from typing import Any

from skyfolio.api.cli.lazy import typer_err
from skyfolio.api.common import kernels
from skyfolio.api.plans.solver import flight_lane


def serve(given: dict[str, Any], *, as_json: bool, ui: bool) -> None:
    """Run the service until interrupted; SIGTERM ends it with status 0. Raises what `serving.serve` does."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # the server takes it over, and gives it back at its end
    kernels.explain(typer_err)
    flight = flight_lane()
    try:
        flight.begin()
        from skyfolio.api.http.server import serve as run  # noqa: PLC0415 - seconds of imports, meanwhile

        run(given, as_json=as_json, ui=ui, flight=flight)
    finally:
        flight.close()
