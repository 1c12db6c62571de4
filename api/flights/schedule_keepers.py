"""The schedule keepers of one flight: each keeps one UAV on the slot clock, and reports what it sees and does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.mavlink_bridge.deviations import AltitudeOffPlan, AltitudeWatch, Deviation, HomeWatch
from skyfolio.mavlink_bridge.keeper import Keeper, Order
from skyfolio.mavlink_bridge.keeping import Kept, keep
from skyfolio.mavlink_bridge.slip import Slip


class ScheduleKeepers:
    """One keeper for each UAV that flies an assigned mission.

    systems: MAVLink system id of each UAV. elapsed_s: returns fleet seconds since slot 0 of the operation began.
    """

    def __init__(
        self, systems: Mapping[str, int], fleet: Fleet, clock: FleetClock, *, elapsed_s: Callable[[], float]
    ) -> None:
        self._systems, self._fleet, self._clock, self._elapsed_s = systems, fleet, clock, elapsed_s
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._home_watches: dict[str, HomeWatch] = {}

    def keep(self, uav: str, assigned: AssignedMission) -> None:
        """Keep this UAV on the schedule of a mission that it has on board, and of no other."""
        self.leave(uav)
        system = self._systems[uav]
        since_s = self._elapsed_s() - assigned.began_s
        model = self._fleet.link.model(system)
        keeper = Keeper(assigned.path_m, assigned.slot_s, assigned.mission, model, since_s=since_s)
        kept = Kept(
            vehicle=self._fleet.link.vehicle(system),
            keeper=keeper,
            origin=assigned.origin,
            altitude=AltitudeWatch(assigned.altitudes, assigned.slot_s),
            home=self._home_watches.setdefault(uav, HomeWatch()),
        )
        events = _KeeperEvents(self._fleet, uav, assigned.first_slot)
        self._tasks[uav] = asyncio.create_task(
            keep(
                {system: kept},
                elapsed_s=lambda: self._elapsed_s() - assigned.began_s,
                now_s=self._clock.now,
                scale=self._clock.scale,
                on_slip=events.slip,
                on_order=events.order,
                on_deviation=events.deviation,
            ),
            name=f"keep-{uav}",
        )

    def leave(self, uav: str) -> None:
        """Stop correcting this UAV."""
        task = self._tasks.pop(uav, None)
        if task is not None:
            task.cancel()

    def leave_all(self) -> None:
        """Stop correcting every UAV."""
        for uav in list(self._tasks):
            self.leave(uav)


class _KeeperEvents:
    """Reports what the schedule keeper of one UAV sees and does.

    first_slot: the slot of the operation with which the UAV's mission begins.
    """

    def __init__(self, fleet: Fleet, uav: str, first_slot: int) -> None:
        self._fleet, self._uav, self._first_slot = fleet, uav, first_slot

    def slip(self, _system_id: int, slip: Slip) -> None:
        """Record how far the UAV is from its plan as a slot begins, and whether that is worth a word."""
        self._fleet.note(
            "slip",
            uav_id=self._uav,
            slot=self._first_slot + slip.slot,
            distance_m=round(slip.distance_m, 2),
            late_s=None if slip.late_s is None else round(slip.late_s, 2),
            off_schedule=slip.off_schedule,
        )

    def order(self, _system_id: int, order: Order) -> None:
        """Report that the UAV was stuck at an item and was sent on; other orders of the keeper are routine."""
        if order.stuck is not None:
            self._fleet.note(
                "stuck",
                uav_id=self._uav,
                level="warning",
                item=order.stuck.item,
                next_item=order.item,
                for_s=order.stuck.for_s,
                distance_m=order.stuck.distance_m,
            )

    def deviation(self, _system_id: int, deviation: Deviation) -> None:
        """Report that the UAV has left its altitude, is back at it, or has a new home."""
        if isinstance(deviation, AltitudeOffPlan):
            level = "warning" if deviation.off else "ok"
            self._fleet.note("altitude_off_plan", uav_id=self._uav, level=level, off_m=deviation.off_m)
        else:
            moved = {"moved_m": deviation.moved_m, "up_m": deviation.up_m}
            self._fleet.note("home_moved", uav_id=self._uav, level="warning", **moved)
