"""`skyfolio bench start`: how long commands take to respond, and the service to start and to stop.

Each time is set beside that of an empty interpreter on the same machine: on a busy one, look at the ratio.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import httpx2
from rich.table import Table

from skyfolio.api.lab.demo.client import free_port

_SKYFOLIO = [sys.executable, "-m", "skyfolio"]
LOOK_EVERY_S = 0.02


def start_figures(runs: int) -> dict[str, Any]:
    """Measure wall seconds of starts, medians of `runs`, beside an empty interpreter.

    `help`, a warm `plan`, `serve` until it is ready, and from SIGTERM until it has ended. `ratios`: each to the
    empty interpreter.
    """
    seconds = {
        "interpreter": _median(runs, lambda: _command([sys.executable, "-c", "pass"])),
        "help": _median(runs, lambda: _command([*_SKYFOLIO, "--help"])),
        "plan": _median(runs, lambda: _command([*_SKYFOLIO, "plan", "--example", "paper", "--json"])),
    }
    served = [_served() for _ in range(runs)]
    seconds["serve_ready"] = median(ready for ready, _ in served)
    seconds["serve_end"] = median(end for _, end in served)
    ratios = {name: took / seconds["interpreter"] for name, took in seconds.items() if name != "interpreter"}
    return {"cores": len(os.sched_getaffinity(0)), "load": os.getloadavg()[0], "seconds": seconds, "ratios": ratios}


def table(figures: dict[str, Any]) -> Table:
    """Return the figures as a table for a terminal."""
    shown = Table("what", "seconds", "x interpreter", title=f"start, load {figures['load']:.1f} on {figures['cores']}")
    for name, took in figures["seconds"].items():
        shown.add_row(name, f"{took:.2f}", f"{figures['ratios'].get(name, 1.0):.0f}")
    return shown


def _median(runs: int, measure: Callable[[], float]) -> float:
    measure()  # fills the file system's cache
    return median(measure() for _ in range(runs))


def _command(command: list[str]) -> float:
    began_s = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603
    return time.perf_counter() - began_s


def _served() -> tuple[float, float]:
    """Return the seconds until `serve` is ready, and from SIGTERM until it has ended."""
    port = free_port(socket.SOCK_STREAM)
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "log").open("wb") as log:
        url = f"sqlite+aiosqlite:///{folder}/service.db"
        command = [*_SKYFOLIO, "serve", "--port", str(port), "--database-url", url, "--json"]
        began_s = time.perf_counter()
        process = subprocess.Popen(command, stdout=log, stderr=log)  # noqa: S603
        try:
            while not _is_ready(port):
                if process.poll() is not None:
                    raise RuntimeError(f"the service ended with {process.returncode}")
                time.sleep(LOOK_EVERY_S)
            ready_s = time.perf_counter() - began_s
            began_s = time.perf_counter()
            process.send_signal(signal.SIGTERM)
            process.wait()
        finally:
            process.kill()
        return ready_s, time.perf_counter() - began_s


def _is_ready(port: int) -> bool:
    try:
        return httpx2.get(f"http://127.0.0.1:{port}/ready").status_code == 200
    except httpx2.TransportError:
        return False
