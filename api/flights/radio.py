"""The radio half of an operation: who serves whom is published, measured, and changed at once after a loss.

Called in each tick of the operation. Here the recovery from a loss begins before any UAV moves: the users of the lost
UAV are shared among the others, from where those are (`planner.reassociate`); the recovery's new plan replaces that as
it replaces the paths. Measurements correct the channel of all plans that are made from then on, and lead to a new plan
by themselves when rates are too far off (`rates_watch`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

import structlog

from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.allocations import Allocations, AllocationsView
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.losses import Loss
from skyfolio.api.flights.measured_rates import Measurement, MeasurementStore
from skyfolio.api.flights.operation_store import OperationIdentity, Stores
from skyfolio.api.flights.rates import InForce
from skyfolio.api.flights.rates_watch import OVER_SLOTS, RatesWatch, difference
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.flights.transition import achieved
from skyfolio.api.plans.solver import SolveError
from skyfolio.planner import Cause, Plan, ReplanError

log = structlog.get_logger()
MOST_IN_EVENT = 2_000
"""Links that an event spells out; of larger fleets it has the revision alone."""


class Radio:
    """What base stations must serve in one operation, and what they report.

    save: stores the operation as it is; called before clients see a revision. may_replan: returns whether a new
    plan may be requested now. request_replan: requests one, with the reason in words.
    """

    def __init__(
        self,
        identity: OperationIdentity,
        flight: Flight,
        shared: SharedServices,
        stores: Stores,
        *,
        save: Callable[[], object],
        may_replan: Callable[[], bool],
        request_replan: Callable[[str], None],
    ) -> None:
        self.allocations = Allocations(identity.id, flight)
        self._identity, self._flight, self._shared, self._events = identity, flight, shared, stores.events
        self._store = MeasurementStore(stores.database, identity.id)
        self._save, self._may_replan, self._request_replan = save, may_replan, request_replan
        self._watch = RatesWatch(shared.settings.replan_rates_share)
        self._tasks: set[asyncio.Task[None]] = set()
        self._is_reassociating = self._is_judging = False
        self._judged_slot = 0
        self._adopted: set[str] = set()

    def document(self) -> dict[str, Any]:
        """Return what a restart needs."""
        flight = self._flight
        known = {entry.plan.id for entry in flight.timeline} | self._adopted
        serving = [entry for entry in flight.serving if entry.plan.id in known]
        return {
            "allocation_revision": self.allocations.revision,
            "serving": [{"from_s": entry.from_s, "plan_id": entry.plan.id} for entry in serving],
        }

    async def restore(self, revision: int, serving: Sequence[InForce]) -> None:
        """Take over from before a restart: the newest revision, who served whom, and what was measured."""
        flight = self._flight
        flight.serving = [*serving] or [*flight.timeline]
        self._adopted = {entry.plan.id for entry in flight.serving} - {entry.plan.id for entry in flight.timeline}
        self.allocations.restore(revision)
        flight.measured.add(await self._store.read())

    def tick(self, lost: Mapping[str, Loss]) -> None:
        """Deal with new losses, publish what is due, and judge the rates of slots that are over."""
        if lost and self._shared.settings.reassociate and self._identity.policy != "off" and not self._is_reassociating:
            self._is_reassociating = True
            self._begin(self._reassociate(lost), "reassociate")
        if not self._is_reassociating and self.allocations.are_due:
            self._publish()
        slot = self._flight.slot()
        if slot is not None and slot > self._judged_slot and self._flight.measured and not self._is_judging:
            self._judged_slot, self._is_judging = slot, True
            self._begin(self._judge(slot), "judge-rates")

    def measure(self, measurements: Sequence[Measurement]) -> int:
        """Take in measurements; return how many of them are new. Raises InvalidError."""
        measured = self._flight.measured
        measured.check(measurements)
        new = measured.add(measurements)
        self._store.write(new)
        return len(new)

    async def end(self) -> None:
        """Stop: the operation is over, or goes to another service."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _begin(self, work: Coroutine[Any, Any, None], name: str) -> None:
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("the radio half of an operation failed unexpectedly", task=task.get_name(), exc_info=error)

    # -- what base stations must serve ----------------------------------------------------------------------------

    def _publish(self) -> None:
        unacknowledged = self.allocations.silent()
        view = self.allocations.renew()
        self._save()
        self._events.add("allocations", **_told(view), unacknowledged=unacknowledged)

    async def _reassociate(self, lost: Mapping[str, Loss]) -> None:
        """Serve the users of lost UAVs by the others. Losses on the way, and new plans, are seen before it is done."""
        flight, error, made = self._flight, None, None
        cause = Cause(kind=next(iter(lost.values())).kind, uav_ids=tuple(lost), detail="served by the others at once")
        creation = fresh("plan")
        try:
            seen = None
            while seen != (seen := (flight.plan.id, {*flight.lost})):
                made = await self._served_by_others(cause, creation.id)
            if made is not None:
                flight.serve_by(made)
        except (ReplanError, SolveError, ServiceError) as reason:
            error = str(reason)
            log.warning("the users of a lost UAV are not served by others", reason=error)
        finally:
            self._is_reassociating = False
        self._publish()
        self._events.add(
            "reassociated",
            operation_id=self._identity.id,
            lost=sorted(flight.lost),
            plan_id=None if made is None else made.id,
            revision=self.allocations.revision,
            error=error,
        )
        if made is not None:
            await self._shared.plans.adopt(made, creation)
            self._adopted.add(made.id)
            self._save()

    async def _served_by_others(self, cause: Cause, plan_id: str) -> Plan | None:
        """Return the plan in force with the best links of its survivors; None if no UAV of it is lost, or all are."""
        flight = self._flight
        plan, lost, slot = flight.plan, {*flight.lost}, flight.slot()
        flying = {*plan.scenario.uav_ids}
        if slot is None or flying <= lost or not flying & lost:
            return None
        at_slot = max(slot, plan.first_slot)
        request = {
            "failed": [uav for uav in plan.scenario.uav_ids if uav in lost],
            "at_slot": at_slot,
            "positions_m": {uav: at_m for uav, at_m in flight.positions_m().items() if uav not in lost},
            "achieved_rates_bps": achieved(flight, plan, at_slot),
            "corrections_db": flight.measured.corrections_db,
        }
        return await self._shared.plans.reassociated(plan, request, cause, plan_id)

    # -- what they report -----------------------------------------------------------------------------------------

    async def _judge(self, slot: int) -> None:
        """Learn the channel from what is new, and request a replan if rates are too far off what was planned."""
        flight = self._flight
        try:
            if flight.pool is None:  # links are learned by vehicle, and those of a pool come and go
                await flight.measured.learn()
            slots = range(max(slot - OVER_SLOTS, 0), slot)
            await flight.settle_rates()
            promised_bps, first_slot = flight.modelled_rates_bps(), flight.rates_from_slot
            off = difference(promised_bps, flight.measured.rate_bps, slots, first_slot)
            if off is None or not self._may_replan() or not self._watch.is_off(slot, off):
                return
            self._events.add("rates_off", operation_id=self._identity.id, slot=slot, difference=round(off, 3))
            if self._identity.policy != "off":
                self._request_replan(f"measured rates are {off:.0%} off those of the plan")
        finally:
            self._is_judging = False


def _told(view: AllocationsView) -> dict[str, Any]:
    """Return what an event says of allocations."""
    links = sum(len(slot.bandwidth_hz) for uav in view.uavs.values() for slot in (uav.now, uav.next) if slot)
    told: dict[str, Any] = view.model_dump(mode="json")
    return told if links <= MOST_IN_EVENT else {**told, "uavs": None}
