"""A stored operation that can be shown at any moment of it. Pure. Times are fleet seconds since slot 0."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import atan2, degrees

from skyfolio.api.dashboard import map_scene
from skyfolio.api.dashboard.views import Operation, ServiceEvent, TrackPoint
from skyfolio.planner import Plan
from skyfolio.planner.geometry import Point

COURSE_OVER_S = 1.5
STILL_M = 0.4


@dataclass(frozen=True)
class Recording:
    """Everything that the service stored of one operation; `plans` by id, `events` with their time in the operation."""

    operation: Operation
    plans: Mapping[str, Plan]
    track: Sequence[TrackPoint]
    events: Sequence[tuple[float, ServiceEvent]]

    @property
    def first(self) -> Plan:
        """The first plan, that of the whole fleet."""
        return self.plans[self.operation.plan_ids[0]]

    @property
    def begins_s(self) -> float:
        """The time of the first event, at most 0."""
        return min([0.0, *(at for at, _ in self.events)])

    @property
    def ends_s(self) -> float:
        """The time of the last event or position, at least the end of the plan."""
        scenario = self.first.scenario
        times_s = [at for at, _ in self.events] + [point.elapsed_s for point in self.track]
        return max([scenario.slots * scenario.slot_duration_s, *times_s])

    def slot(self, at_s: float) -> int | None:
        """Return the slot at that time; None before and after the plan."""
        slot = int(at_s // self.first.scenario.slot_duration_s)
        return slot if 0 <= slot < self.first.scenario.slots else None

    def in_force(self, at_s: float) -> Plan:
        """Return the plan in force at that time."""
        plan = self.first
        for recovery in self.operation.recoveries:
            if recovery.in_force_at_s is not None and recovery.in_force_at_s <= at_s:
                plan = self.plans.get(recovery.plan_id or "", plan)
        return plan

    def lost(self, at_s: float) -> tuple[str, ...]:
        """Return the UAVs declared lost by that time."""
        declared = (recovery for recovery in self.operation.recoveries if recovery.declared_at_s is not None)
        return tuple(uav for recovery in declared if (recovery.declared_at_s or 0.0) <= at_s for uav in recovery.lost)

    def where(self, at_s: float) -> dict[str, tuple[Point, float]]:
        """Return each UAV's position at that time, and its course over ground in degrees."""
        times = [point.elapsed_s for point in self.track]
        now = bisect_right(times, at_s) - 1
        if now < 0:
            return {uav.id: (uav.start_m, 0.0) for uav in self.first.scenario.uavs}
        before = max(bisect_right(times, at_s - COURSE_OVER_S) - 1, 0)
        earlier, found = self.track[before].positions_m, {}
        for uav in self.first.scenario.uav_ids:
            here = next(
                (self.track[n].positions_m[uav] for n in range(now, -1, -1) if uav in self.track[n].positions_m), None
            )
            if here is not None:
                found[uav] = (here, _course(earlier.get(uav, here), here))
        return found

    def frame(self, at_s: float) -> map_scene.Json:
        """Return the frame of the map at that time."""
        lost, plan, slot = self.lost(at_s), self.in_force(at_s), self.slot(at_s)
        spots = [
            map_scene.Spot(uav_id=uav, at_m=at, course_deg=course, lost=uav in lost)
            for uav, (at, course) in self.where(at_s).items()
        ]
        rates: dict[str, float | None] = {}
        if slot is not None:
            table = self.operation.user_rates_bps
            rates = {user: row[slot] if slot < len(row) else None for user, row in table.items()}
        return map_scene.frame(spots, plan, slot, rates, promise=self.first, live=False)

    def tracks(self, at_s: float) -> dict[str, list[Point]]:
        """Return the tracks flown until that time."""
        flown: dict[str, list[Point]] = {}
        for point in self.track:
            if point.elapsed_s > at_s:
                break
            for uav, at in point.positions_m.items():
                flown.setdefault(uav, []).append(at)
        return flown

    def rows(self, at_s: float) -> list[map_scene.Json]:
        """Return the rows of the fleet table at that time."""
        lost, plan = self.lost(at_s), self.in_force(at_s)
        rows = []
        for number, (uav, (at, _)) in enumerate(self.where(at_s).items()):
            gone = uav in lost
            slip = None if gone else map_scene.slip_of(plan, uav, at_s, at)
            rows.append(map_scene.recorded_row(number, uav, lost=gone, slip=slip))
        return rows


def placed(events: Sequence[ServiceEvent], operation_id: str, time_scale: float) -> list[tuple[float, ServiceEvent]]:
    """Return the events of one operation with their times: fleet seconds since it began to fly (slot 0)."""
    own = [event for event in events if event.data.get("operation_id") == operation_id]
    flying = next((event for event in own if event.kind == "operation" and event.data.get("state") == "flying"), None)
    if flying is None:
        return [(0.0, event) for event in own]
    zero = datetime.fromisoformat(flying.at)
    return [((datetime.fromisoformat(event.at) - zero).total_seconds() * time_scale, event) for event in own]


def _course(before: Point, here: Point) -> float:
    de, dn = here[0] - before[0], here[1] - before[1]
    return degrees(atan2(de, dn)) % 360 if de * de + dn * dn > STILL_M**2 else 0.0
