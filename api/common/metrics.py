"""Metrics for Prometheus, one registry per service. Names end in their unit."""

from __future__ import annotations

import asyncio
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

from skyfolio.api.common.surroundings import monotonic_s

FAST = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
BLOCKED = (0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0)
DISTANCE_M = (0.25, 0.5, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 25.0, 50.0)
LATE_S = (-2.0, -1.0, -0.5, 0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
TICK_S = 0.01


class Metrics:
    """Everything that is measured while the service runs."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        common: dict[str, Any] = {"namespace": "skyfolio", "registry": self.registry}
        self.requests = Histogram(
            "request_seconds", "Time to answer", ["method", "route", "status"], buckets=FAST, **common
        )
        self.solve = Histogram("solve_seconds", "Time in the optimiser", ["kind"], buckets=FAST, **common)
        self.iterations = Histogram(
            "solve_iterations", "Outer iterations of a solve", ["kind"], buckets=(1, 2, 5, 10, 20, 50, 100), **common
        )
        self.solves_waiting = Gauge("solves_waiting", "Solves queued or running", ["lane"], **common)
        self.heartbeat_age = Gauge("heartbeat_age_seconds", "Fleet seconds since the last heartbeat", ["uav"], **common)
        self.slip = Gauge("slip_metres", "Distance between a UAV and where the plan has it now", ["uav"], **common)
        self.slot_distance = Histogram(
            "slot_distance_metres", "Distance from the plan as a slot begins", ["uav"], buckets=DISTANCE_M, **common
        )
        self.slot_lateness = Histogram(
            "slot_lateness_seconds",
            "How late a UAV that moves is as a slot begins, or early",
            ["uav"],
            buckets=LATE_S,
            **common,
        )
        self.solver_answers = Gauge("solver_answers", "1 while a worker of the lane responds", ["lane"], **common)
        self.losses = Counter("losses", "UAVs declared lost in flight", ["cause"], **common)
        self.returns = Counter("returns", "Lost UAVs that were heard again", [], **common)
        self.upload_retries = Counter("upload_retries", "Mission uploads that were tried again", [], **common)
        self.replans = Counter("replans", "Recoveries from a change in flight", ["cause", "outcome"], **common)
        self.replan_phase = Histogram(
            "replan_phase_seconds", "Wall time of each phase of a recovery", ["phase"], buckets=FAST, **common
        )
        self.subscribers = Gauge("event_subscribers", "Streams of /v1/events that are open", **common)
        self.events = Counter("events", "Events appended to the log", ["kind"], **common)
        self.loop_lag = Histogram("event_loop_lag_seconds", "How late the event loop wakes", buckets=BLOCKED, **common)
        self.worst_lag_s = 0.0

    def note_slip(self, uav_id: str, distance_m: float, late_s: float | None) -> None:
        """Note how far (metres) and, if it moves, how late (fleet seconds) a UAV was as a slot began."""
        self.slot_distance.labels(uav_id).observe(distance_m)
        if late_s is not None:
            self.slot_lateness.labels(uav_id).observe(late_s)

    def text(self) -> bytes:
        """Return the metrics in Prometheus exposition format."""
        return generate_latest(self.registry)

    async def watch_loop(self) -> None:
        """Measure, for ever, how long a single callback blocks the event loop."""
        while True:
            slept_from_s = monotonic_s()
            await asyncio.sleep(TICK_S)
            late = max(0.0, monotonic_s() - slept_from_s - TICK_S)
            self.loop_lag.observe(late)
            self.worst_lag_s = max(self.worst_lag_s, late)
