"""Figures for Prometheus, one registry a service. Names end in their unit."""

from __future__ import annotations

import asyncio
import time
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

FAST = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
BLOCKED = (0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0)
DISTANCE_M = (0.25, 0.5, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 25.0, 50.0)
LATE_S = (-2.0, -1.0, -0.5, 0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
TICK_S = 0.01


class Metrics:
    """Everything that is measured while the service runs."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        own: dict[str, Any] = {"namespace": "skyfolio", "registry": self.registry}
        self.requests = Histogram(
            "request_seconds", "Time to answer", ["method", "route", "status"], buckets=FAST, **own
        )
        self.solve = Histogram("solve_seconds", "Time in the optimiser", ["kind"], buckets=FAST, **own)
        self.iterations = Histogram(
            "solve_iterations", "Outer iterations of a solve", ["kind"], buckets=(1, 2, 5, 10, 20, 50, 100), **own
        )
        self.solves_waiting = Gauge("solves_waiting", "Solves queued or running", ["lane"], **own)
        self.heartbeat_age = Gauge("heartbeat_age_seconds", "Fleet seconds since the last heartbeat", ["uav"], **own)
        self.slip = Gauge("slip_metres", "Distance between a UAV and where the plan has it now", ["uav"], **own)
        self.slot_distance = Histogram(
            "slot_distance_metres", "Distance from the plan as a slot begins", ["uav"], buckets=DISTANCE_M, **own
        )
        self.slot_lateness = Histogram(
            "slot_lateness_seconds",
            "How late a UAV is as a slot begins, or early",
            ["uav"],
            buckets=LATE_S,
            **own,
        )
        self.solver_answers = Gauge("solver_answers", "1 while a worker of the lane shows it is alive", ["lane"], **own)
        self.losses = Counter("losses", "UAVs declared lost in flight", ["cause"], **own)
        self.returns = Counter("returns", "Lost UAVs that were heard again", [], **own)
        self.upload_retries = Counter("upload_retries", "Mission uploads that were tried again", [], **own)
        self.replans = Counter("replans", "Answers to a change in flight", ["cause", "outcome"], **own)
        self.replan_phase = Histogram(
            "replan_phase_seconds", "Wall time of each phase of an answer", ["phase"], buckets=FAST, **own
        )
        self.subscribers = Gauge("event_subscribers", "Streams of /v1/events that are open", **own)
        self.events = Counter("events", "Events appended to the log", ["kind"], **own)
        self.loop_lag = Histogram("event_loop_lag_seconds", "How late the event loop wakes", buckets=BLOCKED, **own)
        self.worst_lag_s = 0.0

    def note_slip(self, uav_id: str, distance_m: float, late_s: float) -> None:
        """A UAV was this far and this late (fleet seconds) as a slot began."""
        self.slot_distance.labels(uav_id).observe(distance_m)
        self.slot_lateness.labels(uav_id).observe(late_s)

    def text(self) -> bytes:
        """The exposition format."""
        return generate_latest(self.registry)

    async def watch_loop(self) -> None:
        """Measure how long the event loop is kept busy by one thing, forever."""
        while True:
            asked = time.monotonic()
            await asyncio.sleep(TICK_S)
            late = max(0.0, time.monotonic() - asked - TICK_S)
            self.loop_lag.observe(late)
            self.worst_lag_s = max(self.worst_lag_s, late)
