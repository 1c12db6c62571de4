"""A stored operation, to be looked at again at any moment of it. Pure. Times are fleet seconds since slot 0."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import atan2, degrees

from skyfolio.api.dashboard import map_scene as picture
from skyfolio.api.dashboard.views import Happening, Operation, TrackPoint
from skyfolio.planner import Plan

COURSE_OVER_S = 1.5
STILL_M = 0.4
Point = tuple[float, float]


@dataclass(frozen=True)
class Recording:
    """Everything the service kept of one operation; `plans` by id, `happenings` with their time in the operation."""

    operation: Operation
    plans: Mapping[str, Plan]
    track: Sequence[TrackPoint]
    happenings: Sequence[tuple[float, Happening]]

    @property
    def first(self) -> Plan:
        """The plan of the whole fleet."""
        return self.plans[self.operation.plan_ids[0]]

    @property
    def begins_s(self) -> float:
        """When the first thing happened."""
        return min([0.0, *(at for at, _ in self.happenings)])

    @property
    def ends_s(self) -> float:
        """When the last thing happened."""
        scenario = self.first.scenario
        told = [at for at, _ in self.happenings] + [point.elapsed_s for point in self.track]
        return max([scenario.slots * scenario.slot_duration_s, *told])

    def slot(self, at_s: float) -> int | None:
        """The slot that lasts then."""
        slot = int(at_s // self.first.scenario.slot_duration_s)
        return slot if 0 <= slot < self.first.scenario.slots else None

    def in_force(self, at_s: float) -> Plan:
        """The plan users and survivors followed then."""
        plan = self.first
        for one in self.operation.recoveries:
            if one.in_force_at_s is not None and one.in_force_at_s <= at_s:
                plan = self.plans.get(one.plan_id or "", plan)
        return plan

    def lost(self, at_s: float) -> tuple[str, ...]:
        """UAVs declared lost by then."""
        declared = (one for one in self.operation.recoveries if one.declared_at_s is not None)
        return tuple(uav for one in declared if (one.declared_at_s or 0.0) <= at_s for uav in one.lost)

    def where(self, at_s: float) -> dict[str, tuple[Point, float]]:
        """Position of each UAV then, and its course over ground in degrees."""
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

    def frame(self, at_s: float) -> picture.Json:
        """What the map shows then."""
        lost, plan, slot = self.lost(at_s), self.in_force(at_s), self.slot(at_s)
        spots = [
            picture.Spot(uav_id=uav, at_m=at, course_deg=course, lost=uav in lost)
            for uav, (at, course) in self.where(at_s).items()
        ]
        rates: dict[str, float | None] = {}
        if slot is not None:
            table = self.operation.user_rates_bps
            rates = {user: row[slot] if slot < len(row) else None for user, row in table.items()}
        return picture.frame(spots, plan, slot, rates, promise=self.first, live=False)

    def tracks(self, at_s: float) -> dict[str, list[Point]]:
        """What was flown until then."""
        flown: dict[str, list[Point]] = {}
        for point in self.track:
            if point.elapsed_s > at_s:
                break
            for uav, at in point.positions_m.items():
                flown.setdefault(uav, []).append(at)
        return flown

    def rows(self, at_s: float) -> list[picture.Json]:
        """The fleet table then."""
        lost, plan = self.lost(at_s), self.in_force(at_s)
        made = []
        for number, (uav, (at, _)) in enumerate(self.where(at_s).items()):
            gone = uav in lost
            slip = None if gone else picture.slip_of(plan, uav, at_s, at)
            made.append(picture.recorded_row(number, uav, lost=gone, slip_s=slip))
        return made


def placed(happenings: Sequence[Happening], operation_id: str, time_scale: float) -> list[tuple[float, Happening]]:
    """The events of one operation with their time in it: fleet seconds since it began to fly (slot 0)."""
    mine = [one for one in happenings if one.data.get("operation_id") == operation_id]
    flying = next((one for one in mine if one.kind == "operation" and one.data.get("state") == "flying"), None)
    if flying is None:
        return [(0.0, one) for one in mine]
    zero = datetime.fromisoformat(flying.at)
    return [((datetime.fromisoformat(one.at) - zero).total_seconds() * time_scale, one) for one in mine]


def _course(before: Point, here: Point) -> float:
    de, dn = here[0] - before[0], here[1] - before[1]
    return degrees(atan2(de, dn)) % 360 if de * de + dn * dn > STILL_M**2 else 0.0
