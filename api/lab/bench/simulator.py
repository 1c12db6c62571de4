"""How much of a core a simulated fleet takes at real time."""

from __future__ import annotations

import asyncio
import socket
import time
from typing import Any

from rich.table import Table

from skyfolio.mavlink_bridge import Autopilot, FlightMode
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.planner import EXAMPLES
from skyfolio.sim import Fleet, Mode, ScaledClock, grid_of

GLOBAL_POSITION_INT = 33
WARM_UP_S = 8.0
_LOOK_S = 0.05


def simulator_figures(vehicles: int, autopilot: str, position_hz: float, seconds: float) -> dict[str, Any]:
    """Measure CPU share, messages and lag of a fleet in the air on a loopback socket with a reader."""
    return asyncio.run(_measure(vehicles, autopilot, position_hz, seconds))


async def _measure(vehicles: int, autopilot: str, position_hz: float, seconds: float) -> dict[str, Any]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.bind(("127.0.0.1", 0))
        sink.setblocking(False)
        origin = EXAMPLES["paper"]().origin
        guided = profile_of(Autopilot(autopilot)).hold_mode is FlightMode.GUIDED
        hold = Mode.GUIDED if guided else Mode.HOLD
        specs = grid_of(vehicles, origin.lat_deg, origin.lon_deg, autopilot=autopilot)
        fleet = Fleet(specs, clock=ScaledClock(), endpoint=f"udpout://127.0.0.1:{sink.getsockname()[1]}")
        for vehicle in fleet.vehicles.values():
            vehicle.autopilot.set_mode(hold)
            vehicle.autopilot.arm()
            vehicle.autopilot.takeoff(30.0)
            vehicle.autopilot.telemetry.set_interval(GLOBAL_POSITION_INT, 1.0 / position_hz)
        async with fleet:
            await asyncio.sleep(WARM_UP_S)
            for vehicle in fleet.vehicles.values():
                vehicle.autopilot.reposition(500.0, 300.0, 40.0, 8.0)
            return await _watch(fleet, sink, seconds)


async def _watch(fleet: Fleet, sink: socket.socket, seconds: float) -> dict[str, Any]:
    began, cpu, sent = time.monotonic(), time.process_time(), fleet.truth.sent.copy()
    worst_lag_s = 0.0
    while (wall_s := time.monotonic() - began) < seconds:
        await asyncio.sleep(_LOOK_S)
        worst_lag_s = max(worst_lag_s, fleet.clock.now() - fleet.now_s)
        _drain(sink)
    since = fleet.truth.sent - sent
    positions = sum(count for (_, message_id), count in since.items() if message_id == GLOBAL_POSITION_INT)
    return {
        "vehicles": len(fleet.vehicles),
        "cpu_share_of_one_core": round((time.process_time() - cpu) / wall_s, 3),
        "messages_per_s": round(sum(since.values()) / wall_s, 1),
        "positions_per_s_and_vehicle": round(positions / wall_s / len(fleet.vehicles), 2),
        "worst_lag_s": round(worst_lag_s, 3),
    }


def _drain(sink: socket.socket) -> None:
    try:
        while True:
            sink.recv(65_536)
    except BlockingIOError:
        return


def table(figures: dict[str, Any]) -> Table:
    """Return the figures as a table for a terminal."""
    shown = Table(title="Simulated fleet at real time", show_header=False)
    for name, value in figures.items():
        shown.add_row(name.replace("_", " "), str(value))
    return shown
