"""The time of one flight: its slot clock, and which plan was in force when."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.rates import InForce
from skyfolio.planner import Plan, Uav


class FlightTimeline:
    """The slot clock of a flight and its plans. Times are fleet seconds since slot 0 began."""

    def __init__(self, plan: Plan, clock: FleetClock) -> None:
        self.timeline = [InForce(0.0, plan)]
        self.serving = [InForce(0.0, plan)]
        """By which plans users were served: those of the timeline, and those that only changed who serves whom."""
        self._last_slots = _last_slots(plan)
        self._clock = clock
        self._began: float | None = None
        """The fleet second in which slot 0 began."""
        self._frozen_s: float | None = None
        """Where the slot clock stands while it is stopped."""

    @property
    def first_plan(self) -> Plan:
        """Return the plan of the whole fleet with which the operation began."""
        return self.timeline[0].plan

    @property
    def plan(self) -> Plan:
        """Return the plan in force."""
        return self.timeline[-1].plan

    @property
    def uav_ids(self) -> Sequence[str]:
        """Return every UAV that may fly in the operation."""
        return self.first_plan.scenario.uav_ids

    def take_over(self, plan: Plan) -> None:
        """Put this plan into force: users and vehicles follow it from now on."""
        self.take_over_since(self.now_s(), plan)

    def take_over_since(self, from_s: float, plan: Plan) -> None:
        """Put this plan into force from that fleet second on."""
        self.timeline.append(InForce(from_s, plan))
        self._last_slots |= _last_slots(plan)
        self.serving.append(InForce(max(from_s, self.serving[-1].from_s), plan))

    def restore_plans(self, timeline: Sequence[InForce]) -> None:
        """Take over from before a restart which plans were in force since when, the first plan first."""
        self.timeline, self.serving = [*timeline], [*timeline]
        for entry in timeline:
            self._last_slots |= _last_slots(entry.plan)

    def serve_by(self, plan: Plan) -> None:
        """Serve users by this plan from now on, while the vehicles go on as they do."""
        self.serving.append(InForce(self.now_s(), plan))

    def forget_plans_before(self, at_s: float) -> list[Plan]:
        """Forget the plans between the first one and the one in force at that fleet second, and return them."""
        self.serving, _ = _without_those_before(self.serving, at_s)
        self.timeline, forgotten = _without_those_before(self.timeline, at_s)
        return [entry.plan for entry in forgotten]

    @property
    def n_slots(self) -> int:
        """Return the number of slots of the operation, as far as it is planned: up to the end of the plan in force."""
        return self.plan.first_slot + self.plan.scenario.slots

    def last_slot_of(self, uav: str) -> int:
        """Return the last slot of the operation in which a UAV flies, by the newest plan with it; -1 without one."""
        return self._last_slots.get(uav, -1)

    def newest_uav(self, uav: str) -> Uav:
        """Return a UAV as the newest plan that has it describes it. Raises KeyError."""
        for entry in reversed(self.timeline):
            if uav in entry.plan.trajectories_m:
                return entry.plan.scenario.uav(uav)
        raise KeyError(uav)

    def last_slot_s(self, uav: str) -> float:
        """Return when the last slot of a UAV begins: then its mission ends in a landing or a return."""
        return self.last_slot_of(uav) * self.slot_s

    @property
    def slot_s(self) -> float:
        """Return the duration of a slot in fleet seconds."""
        return self.first_plan.scenario.slot_duration_s

    def elapsed_s(self) -> float | None:
        """Return the fleet seconds since slot 0 began, None before. They stand still while the flight is paused."""
        if self._frozen_s is not None:
            return self._frozen_s
        return None if self._began is None else self._clock.now() - self._began

    @property
    def paused(self) -> bool:
        """Return whether the slot clock stands still."""
        return self._frozen_s is not None

    def set_slot_clock(self, elapsed_s: float, *, paused: bool = False) -> None:
        """Set the slot clock after a pause, or after a restart of the service."""
        self._began = self._clock.now() - elapsed_s
        self._frozen_s = elapsed_s if paused else None

    def now_s(self) -> float:
        """Return `elapsed_s` of a flight that has begun; 0 before."""
        return self.elapsed_s() or 0.0

    def slot(self) -> int | None:
        """Return the slot that lasts now; None before the first and after the last."""
        elapsed_s = self.elapsed_s()
        if elapsed_s is None or elapsed_s >= self.n_slots * self.slot_s:
            return None
        return int(elapsed_s // self.slot_s)

    def past_last_slot(self) -> bool:
        """Return whether every slot that is planned is over."""
        return self.now_s() >= self.n_slots * self.slot_s


def _last_slots(plan: Plan) -> dict[str, int]:
    """Return the last slot of the operation in which each UAV of a plan flies."""
    return {uav.id: plan.first_slot + plan.scenario.last_slot(uav) for uav in plan.scenario.uavs}


def _without_those_before(entries: Sequence[InForce], at_s: float) -> tuple[list[InForce], list[InForce]]:
    """Return the first entry with those in force from `at_s` on, and the others."""
    now = max(bisect_right(entries, at_s, key=lambda entry: entry.from_s) - 1, 0)
    return [entries[0], *entries[max(now, 1) :]], [*entries[1:now]]
