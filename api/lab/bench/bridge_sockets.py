"""Swaps in flight and the load of a large fleet on the bridge: real sockets in real time."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from math import ceil
from pathlib import Path
from typing import Any

from skyfolio import sim
from skyfolio.api.fleet.simulated_fleet import specs_at_starts
from skyfolio.api.lab.bench.measure import quantile
from skyfolio.api.lab.bench.tracks import moving_plan
from skyfolio.api.lab.demo.client import free_port
from skyfolio.mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, SwapResult, compile_mission
from skyfolio.mavlink_bridge.errors import VehiclesMissing
from skyfolio.mavlink_bridge.framing import Framer
from skyfolio.planner import Plan


async def swap_row(autopilot: Autopilot, swaps: int) -> dict[str, Any]:
    """Measure the seconds from a swap's order until the new mission is proven and flown, on real sockets."""
    flown = moving_plan(slots=60)
    low = flown.model_copy(update={"scenario": flown.scenario.with_changes(altitude_m=10.0)})
    results: list[SwapResult] = []
    async with hovering(low, autopilot) as (_, link, ids):
        await link.start(ids)
        await asyncio.sleep(5.0)
        for number in range(ceil(swaps / len(ids))):
            swapped = _from_slot(low, number + 2)
            new = {n: compile_mission(swapped, uav, airborne=True, autopilot=autopilot) for n, uav in ids.items()}
            results += (await link.swap(new)).values()
            await asyncio.sleep(1.0)
    seconds = [result.seconds for result in results if result.ok]
    return {
        "autopilot": autopilot.value,
        "swaps": len(results),
        "failures": len(results) - len(seconds),
        "items": len(new[1].items),
        "p50_s": round(quantile(seconds, 0.5), 3),
        "p95_s": round(quantile(seconds, 0.95), 3),
    }


@asynccontextmanager
async def hovering(
    flown: Plan, autopilot: Autopilot, *, speedup: float = 1.0
) -> AsyncIterator[tuple[sim.Fleet, FleetLink, dict[int, str]]]:
    """Yield a fleet over its slot-0 points with the plan's missions on board, and the vehicle of each UAV."""
    specs = specs_at_starts(flown.scenario, autopilot.value)
    ids = {spec.system_id: uav for spec, uav in zip(specs, flown.trajectories_m, strict=True)}
    port, clock = free_port(socket.SOCK_DGRAM), sim.ScaledClock(speedup)
    fleet = sim.Fleet(specs, clock=clock, endpoint=f"udpout://127.0.0.1:{port}")
    async with fleet, FleetLink(clock=clock, monitor=HeartbeatMonitor()) as link:
        await link.connect(f"udpin://127.0.0.1:{port}")
        await link.wait_for(ids, timeout_s=10)
        await link.prepare(ids)
        await link.upload({n: compile_mission(flown, uav, autopilot=autopilot) for n, uav in ids.items()})
        await link.launch(dict.fromkeys(ids, flown.scenario.altitude_m), timeout_s=60)
        yield fleet, link, ids


def _from_slot(flown: Plan, first: int) -> Plan:
    paths = {uav: path[first:] for uav, path in flown.trajectories_m.items()}
    scenario = flown.scenario.with_changes(slots=flown.scenario.slots - first)
    return flown.model_copy(update={"trajectories_m": paths, "scenario": scenario})


async def load_row(seconds: float, vehicles: int = 50) -> dict[str, Any]:
    """Measure the processor time of this process while it follows vehicles of another one, in real time.

    heard: vehicles that the link has, fewer than asked for where the machine cannot simulate so many. fleet_share: of
    the process that simulates them. bytes_per_s, messages_per_s: of each vehicle's link, both ways
    together, frames alone.
    """
    port, clock = free_port(socket.SOCK_DGRAM), sim.ScaledClock(1.0)
    fleet = subprocess.Popen(  # noqa: S603, ASYNC220
        [*_SIMULATE, "--vehicles", str(vehicles), "--endpoint", f"udpout://127.0.0.1:{port}"], stdout=subprocess.DEVNULL
    )
    try:
        async with FleetLink(clock=clock, monitor=HeartbeatMonitor()) as link:
            await link.connect(f"udpin://127.0.0.1:{port}")
            with suppress(VehiclesMissing):  # `heard` says how many there are
                await link.wait_for(range(1, vehicles + 1), timeout_s=60 + vehicles)
            began, used, theirs = time.perf_counter(), time.process_time(), _cpu_s(fleet.pid)
            await asyncio.sleep(seconds)
            took_s = time.perf_counter() - began
            share, fleet_share = (time.process_time() - used) / took_s, (_cpu_s(fleet.pid) - theirs) / took_s
            heard = sum(link.telemetry(n) is not None for n in range(1, vehicles + 1))
            traffic = await _traffic(link, min(seconds, 3.0), vehicles)
    finally:
        fleet.terminate()
        fleet.wait()
    shares = {"share_of_one_core": round(share, 4), "fleet_share": round(fleet_share, 4)}
    return {"vehicles": vehicles, "heard": heard, "seconds": seconds, **shares, **traffic}


_SIMULATE = [sys.executable, "-m", "skyfolio", "simulate", "--booted-s-ago", "60", "--json"]


def _cpu_s(pid: int) -> float:
    """Return the processor seconds of another process so far, from /proc."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def _traffic(link: FleetLink, seconds: float, vehicles: int) -> dict[str, float]:
    """Count what passes the link, for each vehicle."""
    with tempfile.TemporaryDirectory() as folder:
        log = link.record(Path(folder) / "all.tlog")
        began = time.perf_counter()
        await asyncio.sleep(seconds)
        took_s = time.perf_counter() - began
        link.stop_recording(log)
        await asyncio.to_thread(log.wait, 10.0)
        frames = Framer(None).feed(log.path.read_bytes())
    each = took_s * vehicles
    return {"bytes_per_s": sum(len(frame.data) for frame in frames) / each, "messages_per_s": len(frames) / each}
