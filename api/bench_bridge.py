"""Measurements of the bridge on simulated PX4 and ArduCopter: schedule, uploads, swaps, loss detection, load.

Schedule, uploads and loss detection run in virtual time (same numbers on any machine); swaps and load are real sockets
in real time.
"""

from __future__ import annotations

import asyncio
import json
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from math import ceil, cos, sin
from statistics import mean
from typing import Any

from rich.table import Table

import sim
from api.simulate import specs_at_starts
from api.virtual_flight import Guidance, VirtualFlight
from api.virtual_wire import Wire, autopilot_on, lossy
from mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, Mission, compile_mission
from mavlink_bridge.classifier import Classifier
from mavlink_bridge.conditions import Condition, Timing
from mavlink_bridge.pace import Point
from mavlink_bridge.verified import OnBoard, VerifiedUpload
from planner import EXAMPLES, Plan, Scenario, Uav, User, plan

GUIDANCE: tuple[Guidance, ...] = ("naive", "mission", "keeper", "stream")
AGILE = {"WPNAV_JERK": 5.0}
"""What the audit asks an ArduCopter to be set to for slots of 25 m in 5 s: with its default it cannot start so fast."""
UPLOAD_UAVS, UPLOAD_ITEMS, LOSS = 10, 100, 0.1
LATENCY_S = 0.01


def bridge_figures(*, seeds: int = 100, swaps: int = 20, load_s: float = 10.0) -> dict[str, Any]:
    """All figures, one list of rows a topic."""
    return {
        "schedule": schedule_rows(),
        "upload": [upload_row(autopilot, seeds) for autopilot in Autopilot],
        "swap": [asyncio.run(swap_row(autopilot, swaps)) for autopilot in Autopilot],
        "loss": loss_row(),
        "load": asyncio.run(load_row(load_s)),
    }


# -- schedule ---------------------------------------------------------------------------------------------------------


def schedule_rows() -> list[dict[str, Any]]:
    """Metres from the plan at slot ends, for the paper plan and for a track that never rests."""
    paper, moving = plan(EXAMPLES["paper"]()), moving_plan()
    fleets = [
        (Autopilot.PX4, "defaults", {}),
        (Autopilot.ARDUPILOT, "defaults", {}),
        (Autopilot.ARDUPILOT, "WPNAV_JERK 5, as the audit asks", AGILE),
    ]
    return [
        {"plan": name, "autopilot": autopilot.value, "parameters": label, "guidance": guidance, **_distances(flights)}
        for name, flown in (("paper", paper), ("moving", moving))
        for autopilot, label, parameters in fleets
        for guidance in GUIDANCE
        for flights in [
            [VirtualFlight(flown, uav, autopilot, parameters).fly(guidance) for uav in flown.trajectories_m]
        ]
    ]


def _distances(flights: Iterable[Any]) -> dict[str, float]:
    metres = [distance for flown in flights for distance in flown.distances_m]
    return {"mean_m": round(mean(metres), 3), "worst_m": round(max(metres), 3), "slots": len(metres)}


def moving_plan(uavs: int = 3, slots: int = 12, slot_s: float = 5.0) -> Plan:
    """Tracks with legs of 5 to 25 m that turn by about 20 degrees at each slot, hovering now and then."""
    paths = {f"uav-{n}": _track(n, slots) for n in range(1, uavs + 1)}
    scenario = EXAMPLES["paper"]().with_changes(
        slots=slots,
        slot_duration_s=slot_s,
        area_m=((-5000.0, -5000.0), (5000.0, 5000.0)),
        uavs=tuple(Uav(id=uav, start_m=path[0], max_speed_mps=5.0) for uav, path in paths.items()),
        users=(User(id="user-1", position_m=(0.0, 0.0)),),
    )
    return _by_hand(scenario, paths)


def _track(seed: int, slots: int) -> list[Point]:
    chance = random.Random(seed)  # noqa: S311
    path, heading = [(400.0 * seed, 0.0)], 0.0
    for _ in range(slots - 1):
        east, north = path[-1]
        if chance.random() >= 0.15:
            heading += chance.gauss(0, 0.35)
            leg = chance.uniform(5.0, 25.0)
            east, north = east + leg * sin(heading), north + leg * cos(heading)
        path.append((east, north))
    return path


def _by_hand(scenario: Scenario, paths: dict[str, list[Point]]) -> Plan:
    """A plan that flies these paths: the planned paper scenario with them put in."""
    made = plan(EXAMPLES["paper"]())
    return made.model_copy(update={"scenario": scenario, "trajectories_m": paths})


# -- uploads ----------------------------------------------------------------------------------------------------------


def upload_row(autopilot: Autopilot, seeds: int) -> dict[str, Any]:
    """100 items to 10 UAVs at 10 % loss each way: seconds until the whole fleet is verified, for each seed."""
    mission = _long_mission(autopilot)
    times, right, attempts = [], 0, 0
    for seed in range(seeds):
        uploads = [_upload(mission, autopilot, seed * UPLOAD_UAVS + uav) for uav in range(UPLOAD_UAVS)]
        times.append(max(seconds for seconds, _, _ in uploads))
        right += all(ok for _, ok, _ in uploads)
        attempts = max(attempts, *(tries for _, _, tries in uploads))
    return {
        "autopilot": autopilot.value,
        "uavs": UPLOAD_UAVS,
        "items": len(mission.items),
        "loss_each_way": LOSS,
        "latency_ms": LATENCY_S * 1e3,
        "seeds": seeds,
        "right": right,
        "p50_s": round(quantile(times, 0.5), 2),
        "p95_s": round(quantile(times, 0.95), 2),
        "max_s": round(max(times), 2),
        "most_attempts": attempts,
    }


def _upload(mission: Mission, autopilot: Autopilot, seed: int) -> tuple[float, bool, int]:
    """(seconds, whether it is on board and said to be, attempts)."""
    wire, chance = Wire(latency_s=LATENCY_S), random.Random(seed)  # noqa: S311
    vehicle = autopilot_on(wire, autopilot)
    wire.up, wire.down = lossy(chance, LOSS), lossy(chance, LOSS)
    done = wire.run(VerifiedUpload(mission.items, 1, home_first=autopilot is Autopilot.ARDUPILOT))
    on_board = vehicle.missions.plan(0).items
    whole = len(on_board) == len(mission.items)
    return wire.now_s, done.on_board is OnBoard.NEW and whole, done.attempts


def _long_mission(autopilot: Autopilot) -> Mission:
    slots = UPLOAD_ITEMS // 2
    path = [(11.0 * slot + slot % 2, 7.0 * (slot % 3)) for slot in range(slots)]
    scenario = EXAMPLES["paper"]().with_changes(
        slots=slots,
        area_m=((-5000.0, -5000.0), (5000.0, 5000.0)),
        uavs=(Uav(id="uav-1", start_m=path[0], max_speed_mps=5.0),),
    )
    return compile_mission(_by_hand(scenario, {"uav-1": path}), "uav-1", autopilot=autopilot)


# -- swaps ------------------------------------------------------------------------------------------------------------


async def swap_row(autopilot: Autopilot, swaps: int) -> dict[str, Any]:
    """Seconds from the order to swap until the new mission is proven and flown, on real sockets in real time."""
    flown = moving_plan(slots=60)
    low = flown.model_copy(update={"scenario": flown.scenario.with_changes(altitude_m=10.0)})
    specs = [
        sim.VehicleSpec(spec.system_id, spec.home_lat_deg, spec.home_lon_deg, autopilot=autopilot.value)
        for spec in specs_at_starts(low.scenario)
    ]
    ids = {spec.system_id: uav for spec, uav in zip(specs, low.trajectories_m, strict=True)}
    port, clock = free_port(), sim.ScaledClock(1.0)
    fleet = sim.Fleet(specs, clock=clock, endpoint=f"udpout://127.0.0.1:{port}")
    async with fleet, FleetLink(clock=clock, monitor=HeartbeatMonitor()) as link:
        await link.connect(f"udpin://127.0.0.1:{port}")
        await link.wait_for(ids, timeout_s=10)
        await link.prepare(ids)
        await link.upload({n: compile_mission(low, uav, autopilot=autopilot) for n, uav in ids.items()})
        await link.launch(dict.fromkeys(ids, 10.0), timeout_s=60)
        await link.start(ids)
        await asyncio.sleep(5.0)
        seconds: list[float] = []
        failures = 0
        for number in range(ceil(swaps / len(ids))):
            new = {
                n: compile_mission(_from_slot(low, number + 2), uav, airborne=True, autopilot=autopilot)
                for n, uav in ids.items()
            }
            results = await link.swap(new)
            seconds += [result.seconds for result in results.values() if result.ok]
            failures += sum(not result.ok for result in results.values())
            await asyncio.sleep(1.0)
    return {
        "autopilot": autopilot.value,
        "swaps": len(seconds) + failures,
        "failures": failures,
        "items": len(new[1].items),
        "p50_s": round(quantile(seconds, 0.5), 3),
        "p95_s": round(quantile(seconds, 0.95), 3),
    }


def _from_slot(flown: Plan, first: int) -> Plan:
    paths = {uav: path[first:] for uav, path in flown.trajectories_m.items()}
    scenario = flown.scenario.with_changes(slots=flown.scenario.slots - first)
    return flown.model_copy(update={"trajectories_m": paths, "scenario": scenario})


# -- loss -------------------------------------------------------------------------------------------------------------


def loss_row(*, deaths: int = 2000, uav_hours: float = 50.0, poll_s: float = 0.25) -> dict[str, Any]:
    """Heartbeats at 1 Hz, a tenth of them lost: seconds from death to declared loss, and losses of the living."""
    chance = random.Random(0)  # noqa: S311
    delays = [_declared_after(chance, poll_s) for _ in range(deaths)]
    false = sum(_false_losses(chance, 3600.0, poll_s) for _ in range(round(uav_hours)))
    return {
        "heartbeat_hz": 1.0,
        "random_loss": LOSS,
        "lost_after_s": Timing().lost_after_s,
        "deaths": deaths,
        "declared_p50_s": round(quantile(delays, 0.5), 2),
        "declared_p99_s": round(quantile(delays, 0.99), 2),
        "uav_hours": uav_hours,
        "false_losses_per_10_uav_hours": false / uav_hours * 10,
    }


def _declared_after(chance: random.Random, poll_s: float) -> float:
    classifier, now_s = Classifier(), 0.0
    classifier.watch(1, 0.0)
    dies_s = chance.uniform(20.0, 21.0)
    beat_s = chance.random()
    while True:
        if now_s >= beat_s:
            if beat_s < dies_s and chance.random() >= LOSS:
                classifier.alive(1, 1, beat_s)
            beat_s += 1.0
        if any(change.after is Condition.LINK_LOST for change in classifier.poll(now_s)) and now_s > dies_s:
            return now_s - dies_s
        if now_s > dies_s and classifier.condition(1) is Condition.LINK_LOST:
            return 0.0  # a run of lost heartbeats was going on when it died
        now_s += poll_s


def _false_losses(chance: random.Random, seconds: float, poll_s: float) -> int:
    classifier, now_s, false = Classifier(), 0.0, 0
    classifier.watch(1, 0.0)
    beat_s = chance.random()
    while now_s < seconds:
        if now_s >= beat_s:
            if chance.random() >= LOSS:
                classifier.alive(1, 1, beat_s)
            beat_s += 1.0
        false += sum(change.after is Condition.LINK_LOST for change in classifier.poll(now_s))
        now_s += poll_s
    return false


# -- load -------------------------------------------------------------------------------------------------------------


async def load_row(seconds: float, vehicles: int = 50) -> dict[str, Any]:
    """Processor time of this process while it follows 50 vehicles of another one, in real time."""
    port, clock = free_port(), sim.ScaledClock(1.0)
    command = [sys.executable, "-m", "api", "simulate", "--vehicles", str(vehicles), "--json"]
    fleet = subprocess.Popen(  # noqa: S603, ASYNC220
        [*command, "--endpoint", f"udpout://127.0.0.1:{port}"], stdout=subprocess.DEVNULL
    )
    try:
        async with FleetLink(clock=clock, monitor=HeartbeatMonitor()) as link:
            await link.connect(f"udpin://127.0.0.1:{port}")
            await link.wait_for(range(1, vehicles + 1), timeout_s=60)
            began, used = time.perf_counter(), time.process_time()
            await asyncio.sleep(seconds)
            share = (time.process_time() - used) / (time.perf_counter() - began)
            heard = sum(link.telemetry(n) is not None for n in range(1, vehicles + 1))
    finally:
        fleet.terminate()
        fleet.wait()
    return {"vehicles": vehicles, "heard": heard, "seconds": seconds, "share_of_one_core": round(share, 3)}


def free_port() -> int:
    """A UDP port nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def quantile(values: Sequence[float], share: float) -> float:
    """The value that this share of the values does not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, ceil(share * len(ordered)) - 1))]


def tables(figures: dict[str, Any]) -> list[Table]:
    """The figures for the eye."""
    shown = []
    for topic, rows in figures.items():
        listed = rows if isinstance(rows, list) else [rows]
        one = Table(*listed[0], title=topic)
        for row in listed:
            one.add_row(*(value if isinstance(value, str) else json.dumps(value) for value in row.values()))
        shown.append(one)
    return shown
