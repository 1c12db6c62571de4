"""Schedule, uploads and loss detection of the bridge in virtual time: the same numbers on any machine."""

from __future__ import annotations

import random
from collections.abc import Iterable
from statistics import mean
from typing import Any

from skyfolio.api.lab.bench.measure import quantile
from skyfolio.api.lab.bench.tracks import by_hand, moving_plan
from skyfolio.api.lab.virtual_flight import Guidance, VirtualFlight
from skyfolio.api.lab.virtual_wire import Wire, autopilot_on, lossy
from skyfolio.mavlink_bridge import Autopilot, Mission, compile_mission
from skyfolio.mavlink_bridge.classifier import Classifier
from skyfolio.mavlink_bridge.conditions import Condition, Timing
from skyfolio.mavlink_bridge.verified import OnBoard, VerifiedUpload
from skyfolio.planner import EXAMPLES, Uav, plan

GUIDANCE: tuple[Guidance, ...] = ("naive", "mission", "keeper", "stream")
AGILE = {"WPNAV_JERK": 5.0}
"""What the audit asks an ArduCopter to be set to for slots of 25 m in 5 s: with its default it cannot start so fast."""
UPLOAD_UAVS, UPLOAD_ITEMS, LOSS = 10, 100, 0.1
LATENCY_S = 0.01


def schedule_rows() -> list[dict[str, Any]]:
    """Measure the metres from the plan at slot ends, for the paper plan and for a track that never rests."""
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


def upload_row(autopilot: Autopilot, seeds: int) -> dict[str, Any]:
    """Upload 100 items to 10 UAVs at 10 % loss each way: seconds until all are verified, for each seed."""
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
    """Return (seconds, whether the mission is on board and reported to be, attempts)."""
    wire, chance = Wire(latency_s=LATENCY_S), random.Random(seed)  # noqa: S311
    vehicle = autopilot_on(wire, autopilot)
    wire.up, wire.down = lossy(chance, LOSS), lossy(chance, LOSS)
    done = wire.run(VerifiedUpload(mission.items, 1, autopilot=autopilot))
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
    return compile_mission(by_hand(scenario, {"uav-1": path}), "uav-1", autopilot=autopilot)


def loss_row(*, deaths: int = 2000, uav_hours: float = 50.0, poll_s: float = 0.25) -> dict[str, Any]:
    """Send heartbeats at 1 Hz and lose a tenth: seconds from death to declared loss, and false losses."""
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
