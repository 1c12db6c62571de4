"""`skyfolio bench bridge`: the bridge on simulated PX4 and ArduCopter.

Schedule, uploads and loss detection run in virtual time (`bridge_virtual.py`); swaps, starts and load on real sockets
in real time (`bridge_sockets.py`, `bridge_start.py`).
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

from rich.table import Table

from skyfolio.api.lab.bench.bridge_sockets import load_row, swap_row
from skyfolio.api.lab.bench.bridge_start import start_row
from skyfolio.api.lab.bench.bridge_virtual import loss_row, schedule_rows, upload_row
from skyfolio.api.lab.bench.tables import on_terminal
from skyfolio.mavlink_bridge import Autopilot


def bridge_figures(*, seeds: int = 100, swaps: int = 20, starts: int = 10, load_s: float = 10.0) -> dict[str, Any]:
    """Return all figures, one list of rows per topic."""
    return {
        "schedule": schedule_rows(),
        "upload": [upload_row(autopilot, seeds) for autopilot in Autopilot],
        "swap": [asyncio.run(swap_row(autopilot, swaps)) for autopilot in Autopilot],
        "start": [asyncio.run(start_row(autopilot, loss, starts)) for loss in (0.0, 0.1) for autopilot in Autopilot],
        "loss": loss_row(),
        "load": asyncio.run(load_row(load_s)),
    }


def tables(figures: dict[str, Any]) -> list[Table]:
    """Return the figures as tables for a terminal."""
    shown = []
    for topic, rows in figures.items():
        listed = rows if isinstance(rows, list) else [rows]
        lines = [[value if isinstance(value, str) else json.dumps(value) for value in row.values()] for row in listed]
        shown.append(on_terminal(topic, [list(listed[0]), *lines]))
    return shown
