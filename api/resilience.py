"""The resilience loop: a UAV is lost -> replan for the survivors -> swap their missions in flight -> fly on."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import combinations
from math import ceil, hypot
from typing import Any, Literal

import numpy as np
import structlog
from pydantic import BaseModel

from api.clock import FleetClock
from api.flight import Flight
from api.plan_book import PlanBook
from api.problems import ServiceError
from api.rates import Point
from api.settings import Settings
from mavlink_bridge import BridgeError, compile_mission
from planner import Cause, Plan, ReplanError, closest_approach, remaining

log = structlog.get_logger()


class Recovery(BaseModel):
    """One answer to a loss. `_s` of the flight are fleet seconds since slot 0; solve and upload are wall time."""

    outcome: Literal["flying", "partly_flying", "too_late", "failed"]
    lost: dict[str, float]
    declared_at_s: float
    at_slot: int
    plan_id: str | None = None
    replan_ms: float | None = None
    upload_s: float | None = None
    in_force_at_s: float | None = None
    vehicles: dict[str, str | None] = {}
    error: str | None = None


class Responder:
    """Answers losses. A failed answer leaves the last good plan in force, and the missions that fly it."""

    def __init__(self, settings: Settings, plans: PlanBook, clock: FleetClock) -> None:
        self._settings, self._plans, self._clock = settings, plans, clock

    async def recover(self, flight: Flight, lost: dict[str, float]) -> Recovery:
        """Replan for the survivors and swap their missions; what was done, step by step, with timings."""
        declared = flight.now_s()
        lead_s = self._settings.guidance_lead_s * self._clock.scale
        report = Recovery(
            outcome="failed", lost=lost, declared_at_s=declared, at_slot=ceil((declared + lead_s) / flight.slot_s)
        )
        if report.at_slot >= flight.n_slots - 1:
            return report.model_copy(update={"outcome": "too_late", "error": "no slot is left to fly differently"})
        try:
            plan = await self._replan(flight, report)
            report = report.model_copy(update={"plan_id": plan.id, "replan_ms": plan.solve_ms})
            return await self._swap(flight, plan, report)
        except (ReplanError, ServiceError, BridgeError) as error:
            log.warning("recovery failed", reason=str(error))
            return report.model_copy(update={"error": str(error)})

    async def _replan(self, flight: Flight, report: Recovery) -> Plan:
        failed = [uav for uav in flight.plan.scenario.uav_ids if uav in flight.lost]
        live = flight.positions_m()
        request: dict[str, Any] = {
            "failed": failed,
            "at_slot": report.at_slot,
            "positions_m": {
                uav: expected_position(flight.plan, uav, live[uav], report.declared_at_s, report.at_slot)
                for uav in flight.plan.scenario.uav_ids
                if uav in live and uav not in flight.lost
            },
            "achieved_rates_bps": _achieved(flight, report.at_slot),
        }
        remaining(flight.plan, **request)
        detail = ", ".join(f"{uav} silent for {silent:.1f} s" for uav, silent in report.lost.items())
        cause = Cause(
            kind="heartbeat_lost", uav_ids=tuple(report.lost), detail=detail, silent_for_s=max(report.lost.values())
        )
        record = self._plans.submit_replan(flight.plan.id, request, cause, self._settings.replan_deadline_s)
        await record.done.wait()
        return self._plans.finished(record.id)

    async def _swap(self, flight: Flight, plan: Plan, report: Recovery) -> Recovery:
        live, now = flight.positions_m(), flight.now_s()
        boundary_s = (plan.first_slot + 1) * flight.slot_s
        _require_separated(plan, live)
        missions = {
            uav: compile_mission(
                begun_at(plan, uav, live[uav]), uav, airborne=True, first_leg_s=max(boundary_s - now, flight.slot_s / 2)
            )
            for uav in plan.scenario.uav_ids
        }
        began = time.monotonic()
        results = await flight.swap(missions)
        upload_s = time.monotonic() - began
        flying = [uav for uav, error in results.items() if error is None]
        if flying:
            flight.take_over(plan)
        outcome = "flying" if len(flying) == len(results) else "partly_flying" if flying else "failed"
        return report.model_copy(
            update={
                "outcome": outcome,
                "upload_s": upload_s,
                "in_force_at_s": flight.now_s() if flying else None,
                "vehicles": results,
                "error": None if outcome == "flying" else "not every survivor confirmed its new mission",
            }
        )


def expected_position(plan: Plan, uav_id: str, live_m: Point, now_s: float, at_slot: int) -> Point:
    """Where a UAV that follows `plan` will be when slot `at_slot` begins, in metres east/north.

    It flies from where it is now toward the points of the slots between, at most at its maximum speed.
    """
    scenario = plan.scenario
    speed = next(uav.max_speed_mps for uav in scenario.uavs if uav.id == uav_id)
    budget = max(at_slot * scenario.slot_duration_s - now_s, 0.0) * speed
    first = int(now_s // scenario.slot_duration_s) + 1 - plan.first_slot
    path: Sequence[Point] = plan.trajectories_m[uav_id][max(first, 0) : at_slot - plan.first_slot + 1]
    here = live_m
    for point in path:
        step = hypot(point[0] - here[0], point[1] - here[1])
        if step > budget:
            share = budget / step
            return here[0] + share * (point[0] - here[0]), here[1] + share * (point[1] - here[1])
        here, budget = point, budget - step
    return here


def begun_at(plan: Plan, uav_id: str, live_m: Point) -> Plan:
    """The plan with this UAV's first point where it really is, so that its first leg is timed from there."""
    path = [live_m, *plan.trajectories_m[uav_id][1:]]
    return plan.model_copy(update={"trajectories_m": {**plan.trajectories_m, uav_id: path}})


def _require_separated(plan: Plan, live: dict[str, Point]) -> None:
    """Refuse a transition in which two survivors come closer than `D_min` on their first legs."""
    legs = {
        uav: [live[uav], plan.trajectories_m[uav][min(1, plan.scenario.slots - 1)]] for uav in plan.scenario.uav_ids
    }
    for a, b in combinations(legs, 2):
        apart = closest_approach(np.array([legs[a], legs[b]]))
        if apart < plan.scenario.min_separation_m:
            raise ReplanError(f"transition: {a!r} and {b!r} would come within {apart:.1f} m on the way to the new plan")


def _achieved(flight: Flight, at_slot: int) -> dict[str, list[float]]:
    """Rates of every slot before `at_slot`: as reported, and as last seen for slots that are still to come."""
    table = {}
    for user, row in flight.reported_rates_bps().items():
        filled: list[float] = []
        for rate in row[:at_slot]:
            filled.append(rate if rate is not None else (filled[-1] if filled else 0.0))
        table[user] = filled
    return table
