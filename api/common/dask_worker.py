"""What every worker process of our own Dask cluster does first (Dask calls `dask_setup`)."""

from __future__ import annotations

import signal


def dask_setup(worker: object) -> None:  # noqa: ARG001 - Dask's signature
    """Ignore Ctrl-C: a terminal sends it to the whole group, and the process that started the workers ends them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
