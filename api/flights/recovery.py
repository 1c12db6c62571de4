"""The recovery from an incident: replan for the survivors, check, swap their missions in flight, and fly on.

One `Recovery` deals with one incident, and writes each step into the journal before it takes it. If a step fails the
recovery plans again for a later slot, tries a swap again from where the UAV then is, gives the UAV the last good plan,
and at last leaves it holding. Meanwhile the missions on board of the survivors fly the last good plan.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal

import structlog

from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.endless.relieving import cross, relief_of
from skyfolio.api.flights.endless.terms import LEAST_LEFT_SLOTS
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.journal import IncidentLog, Step
from skyfolio.api.flights.losses import LOSS_KINDS, LossKind
from skyfolio.api.flights.recovery_report import RecoveryReport, changes_of
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.flights.swap import Swap
from skyfolio.api.flights.transition import Present, achieved, require_in_reach, require_separated
from skyfolio.api.flights.whereabouts import whereabouts
from skyfolio.api.plans.solver import LaneName
from skyfolio.mavlink_bridge import BridgeError
from skyfolio.planner import Cause, Changes, Pins, Plan, ReplanError, remaining
from skyfolio.planner.rota.relief import Relief

log = structlog.get_logger()
PLANNING_ATTEMPTS = 3
STAYS = {"leaves_at_slot": None, "on_air_from_slot": None, "off_air_from_slot": None}
"""What a UAV that comes back has no longer to do as the plan had it."""
DECISION_LOOK_S = 0.2
"""Wall seconds between looks whether there is still time to wait for the operator."""
LOCATED_LOOK_S = 0.1
"""Wall seconds between looks whether the position of every survivor is known again."""


@dataclass
class Incident:
    """What has to be dealt with, and how far the recovery is.

    disruption_weight: what a change of the plan must be worth, kbit/s. ask: whether the operator is asked before a new
    plan is flown. detail: of a cause that is no loss. reliever: who takes over a station, in a relief. approval: set
    when the operator has decided.
    """

    log: IncidentLog
    cause: LossKind | Literal["uav_returned", "retuned", "rates_off", "extended", "relief"]
    lost: dict[str, float]
    disruption_weight: float = 0.0
    ask: bool = False
    readmitted: tuple[str, ...] = ()
    detail: str = ""
    reliever: str | None = None
    proposed: Plan | None = None
    approval: asyncio.Future[bool] | None = None
    attempts: list[str] = field(default_factory=list)


async def _save_nothing() -> None:
    """Stand in for what stores the operation."""


class TooLateError(Exception):
    """No slot is left that could be flown differently."""


class Recovery:
    """The recovery from one incident. save: stores the operation, with what a restart has to know of a relief.

    If it fails the last good plan stays in force, and so do the missions that fly it.
    """

    def __init__(
        self,
        shared: SharedServices,
        flight: Flight,
        incident: Incident,
        save: Callable[[], Awaitable[None]] = _save_nothing,
    ) -> None:
        self._shared, self._flight, self._incident, self._save = shared, flight, incident, save
        self._relief: Relief | None = None
        self.report = RecoveryReport(
            outcome="failed",
            incident=incident.log.number,
            cause=incident.cause,
            lost=incident.lost,
            declared_at_s=flight.now_s(),
            at_slot=self._next_slot(),
        )

    async def run(self) -> RecoveryReport:
        """Take every step from replanning to closing; return what was done, with timings."""
        try:
            plan = await self._agreed_plan()
            if plan is None:
                self._update(outcome="declined", error="the operator declined the new plan")
            else:
                await self._swap(plan)
        except TooLateError as error:
            self._update(outcome="too_late", error=str(error))
        except (ReplanError, ServiceError, BridgeError) as error:
            log.warning("recovery failed", reason=str(error))
            self._update(error=str(error))
        await self.close()
        return self.report

    async def close(self, **changes: Any) -> None:
        """Write the last step and the figures, once."""
        steps = self._incident.log
        if steps.closed:
            return
        self._update(**changes)
        await steps.step(Step.CLOSED, outcome=self.report.outcome, error=self.report.error)
        self._update(timings_s=dict(steps.timings_s))
        for phase, seconds in steps.timings_s.items():
            self._shared.metrics.replan_phase.labels(phase).observe(seconds)
        self._shared.metrics.replans.labels(self._incident.cause, self.report.outcome).inc()

    # -- a plan that may be flown ---------------------------------------------------------------------------------

    async def _agreed_plan(self) -> Plan | None:
        """Return a checked plan that the operator approved where the policy asks for that; None if it was declined."""
        agreed = not self._incident.ask
        for attempt in range(1, PLANNING_ATTEMPTS + 1):
            plan = await self._checked_plan(attempt)
            if plan is None:
                continue
            if not agreed:
                if not await self._ask(plan):
                    return None
                agreed = True
                if not self._still_fits(plan):  # the operator took a while: the same decision, newer numbers
                    continue
            if await self._waited_for_links() and not self._still_fits(plan):
                continue
            return plan
        raise ReplanError(
            f"transition: no plan can be flown from where the survivors are: {'; '.join(self._incident.attempts)}"
        )

    async def _checked_plan(self, attempt: int) -> Plan | None:
        steps, flight = self._incident.log, self._flight
        await self._wait_for_positions()
        at_slot = self._next_slot() + attempt - 1
        if at_slot >= flight.n_slots - 1:
            raise TooLateError("no slot is left to fly differently")
        self._update(at_slot=at_slot)
        await steps.step(Step.REPLANNED, at_slot=at_slot, attempt=attempt)
        try:
            plan = await self._plan(at_slot, use_ready=attempt == 1)
            await steps.step(Step.CHECKED, plan_id=plan.id, source=self.report.source, replan_ms=plan.solve_ms)
            self._check(plan)
            if self._relief is not None and self._incident.reliever is not None and flight.pool is not None:
                cross(flight.pool, plan.id, self._incident.reliever, self._relief)
                await self._save()
        except (ReplanError, ServiceError) as error:
            self._incident.attempts.append(str(error))
            await steps.step(Step.REFUSED, attempt=attempt, error=str(error))
            return None
        self._update(plan_id=plan.id, replan_ms=plan.solve_ms, **changes_of(plan))
        return plan

    async def _wait_for_positions(self) -> None:
        """Wait until every survivor knows where it is: no way into a plan starts from an unknown position.

        A survivor that does not find its position again is declared lost when it lands, which ends this recovery.
        Raises TooLateError when no slot is left.
        """
        is_journaled = False
        while unlocated := self._unlocated():
            because = f"no position of {', '.join(unlocated)}"
            if not is_journaled:
                is_journaled = True
                await self._incident.log.step(Step.WAITING, because=because)
            self._require_a_slot(f"no slot is left to fly differently: {because}")
            await asyncio.sleep(LOCATED_LOOK_S)

    def _unlocated(self) -> list[str]:
        """Return the survivors of the plan that are heard and do not know where they are."""
        flight, known = self._flight, self._flight.positions_m()
        flying = [uav for uav in flight.surviving() if uav in flight.plan.trajectories_m]
        return [uav for uav in flying if uav not in known and flight.telemetry(uav) is not None]

    async def _waited_for_links(self) -> bool:
        """Wait while the link of a UAV is stale, unless another was lost; return whether it was.

        It is live or lost soon. A loss ends this recovery, which would go on for as long as what is sent to a dead
        vehicle is tried again. Raises TooLateError when no slot is left.
        """
        waited, flight = False, self._flight
        while not self._incident.lost and any(flight.roster.is_stale(uav) for uav in flight.surviving()):
            waited = True
            self._require_a_slot("no slot is left to fly differently: the link of a UAV is stale")
            await asyncio.sleep(LOCATED_LOOK_S)
        return waited

    def _require_a_slot(self, otherwise: str) -> None:
        """Raise TooLateError, which says `otherwise`, when no slot is left that can be flown differently."""
        if self._next_slot() >= self._flight.n_slots - 1:
            raise TooLateError(otherwise)

    def _next_slot(self) -> int:
        """Return the first slot that can still be flown differently."""
        lead_s = self._shared.settings.guidance_lead_s * self._shared.clock.scale
        return ceil((self._flight.now_s() + lead_s) / self._flight.slot_s)

    async def _plan(self, at_slot: int, *, use_ready: bool) -> Plan:
        flight, incident = self._flight, self._incident
        detail = incident.detail or ", ".join(
            f"{uav} {flight.roster.losses[uav].detail}" for uav in incident.lost if uav in flight.roster.losses
        )
        cause = Cause(
            kind=incident.cause,
            uav_ids=tuple(incident.lost) or incident.readmitted,
            detail=detail,
            silent_for_s=max(incident.lost.values(), default=None),
        )
        if use_ready and (ready := self._ready(at_slot)) is not None:
            self._update(source="planned_ahead")
            return await self._shared.plans.adopt(ready.model_copy(update={"cause": cause}), fresh("plan"))
        self._update(source="solved")
        previous = self._previous()
        await flight.settle_rates()
        request = self._request(previous, at_slot)
        pins = await self._pins(previous, request)
        remaining(previous, **request)
        record = await self._shared.plans.submit_replan(
            previous,
            {
                **request,
                "pins": pins,
                "keep_pins": flight.pool is None,
                "disruption_weight": incident.disruption_weight,
                "in_force": None if previous is flight.plan else flight.plan,
            },
            cause,
            fresh("plan"),
            deadline_s=self._shared.settings.replan_deadline_s,
            lane=LaneName.FLIGHT,
        )
        try:
            await record.done.wait()
        except asyncio.CancelledError:
            await self._shared.plans.cancel(record.id)
            raise
        return await self._shared.plans.finished(record.id)

    def _previous(self) -> Plan:
        """Return the plan of which the new one is a replan: a UAV that returns is in the first one, if that reaches."""
        flight = self._flight
        return flight.first_plan if self._incident.readmitted and flight.horizon is None else flight.plan

    def _ready(self, at_slot: int) -> Plan | None:
        """Return the plan made ahead for exactly this loss, if the survivors can still get into it.

        It does not reach further than the plan in force: where that has to be extended, it is of no use.
        """
        flight = self._flight
        lost = [uav for uav in flight.plan.scenario.uav_ids if uav in flight.lost]
        if flight.horizon is not None and (flight.horizon.is_due() or self._incident.cause not in LOSS_KINDS):
            return None
        if len(lost) != 1 or flight.measured.differ_from(flight.plan.scenario.channel.corrections_db):
            return None
        weight = self._incident.disruption_weight
        plan = self._shared.contingencies.ready(flight.plan, at_slot, lost[0], weight)
        if plan is None or whereabouts(flight, flight.plan, at_slot)["used_wh"]:
            return None
        try:
            self._check(plan)
        except ReplanError as error:
            log.info("the plan made ahead cannot be flown", reason=str(error))
            return None
        return plan

    def _request(self, previous: Plan, at_slot: int) -> dict[str, Any]:
        flight = self._flight
        return {
            "failed": [uav for uav in previous.scenario.uav_ids if uav in flight.lost],
            "at_slot": at_slot,
            **whereabouts(flight, previous, at_slot, self._incident.readmitted),
            "achieved_rates_bps": achieved(flight, previous, at_slot),
            "corrections_db": flight.measured.corrections_db,
            "changes": self._changes(at_slot),
        }

    async def _pins(self, previous: Plan, request: dict[str, Any]) -> Pins:
        """Return what the new plan is held to: who relieves, and who leaves, flies on as that was planned.

        For a relief the request is given its changes. Raises ReplanError where no relief is possible.
        """
        pool, flight, at_slot = self._flight.pool, self._flight, request["at_slot"]
        if pool is None:
            return Pins()
        if self._incident.reliever is not None:
            made = await relief_of(pool, flight, previous, request, self._incident.reliever)
            request["changes"], self._relief = made.changes, made
            return made.pins
        flown = {entry.plan.id for entry in flight.timeline}
        under_way = pool.under_way(flown, at_slot) if len(self._incident.attempts) < PLANNING_ATTEMPTS - 1 else []
        scenario, _ = remaining(previous, **request)
        return Pins(uavs=tuple(uav for uav in scenario.uav_ids if uav in under_way))

    def _changes(self, at_slot: int) -> Changes | None:
        """Return what else is different: every new plan of an operation without a fixed end reaches to its horizon.

        Each further attempt asks for less: energy may not last as long.
        """
        flight = self._flight
        if flight.horizon is None:
            return None
        at_m = flight.positions_m()
        back = tuple(
            flight.newest_uav(uav).model_copy(update={"start_m": at_m[uav], **STAYS})
            for uav in self._incident.readmitted
        )
        slots = flight.horizon.slots_from(at_slot, tried=len(self._incident.attempts))
        return Changes(slots=slots, returned=back)

    def _check(self, plan: Plan) -> None:
        """Raise ReplanError if the survivors cannot fly from where they are into the plan."""
        positions_m = self._flight.positions_m()
        missing = [uav for uav in plan.scenario.uav_ids if uav not in positions_m]
        if missing:
            raise ReplanError(f"positions_m: no position was received from {', '.join(missing)}")
        if not self._in_time(plan):
            raise ReplanError(f"at_slot: slot {plan.first_slot} is over before its plan could be flown")
        require_separated(dict.fromkeys(plan.scenario.uav_ids, plan), Present.of(self._flight))
        left_s = (plan.first_slot + 1) * self._flight.slot_s - self._flight.now_s()
        require_in_reach(plan, positions_m, left_s, self._flight.heights_m())

    def _still_fits(self, plan: Plan) -> bool:
        """Return whether the plan that was checked before a wait can still be flown."""
        try:
            self._check(plan)
        except ReplanError as error:
            self._incident.attempts.append(str(error))
            return False
        return True

    def _in_time(self, plan: Plan) -> bool:
        return self._flight.now_s() < (plan.first_slot + 0.5) * self._flight.slot_s

    async def _ask(self, plan: Plan) -> bool:
        """Propose the plan and wait for the operator; return whether the plan was approved. Raises TooLateError."""
        incident = self._incident
        incident.proposed, incident.approval = plan, asyncio.get_running_loop().create_future()
        await incident.log.step(Step.PROPOSED, plan_id=plan.id)
        try:
            while not incident.approval.done():
                if self._next_slot() >= self._decide_before_slot():
                    raise TooLateError("no decision was made while there was still a slot to fly differently")
                await asyncio.wait({incident.approval}, timeout=DECISION_LOOK_S)
            agreed = incident.approval.result()
        finally:
            incident.proposed = incident.approval = None
        if agreed:
            await incident.log.step(Step.APPROVED, plan_id=plan.id)
        return agreed

    def _decide_before_slot(self) -> int:
        """Return the slot until which the operator may decide: a plan that has to be extended leaves time for that."""
        spare = 0 if self._flight.horizon is None else LEAST_LEFT_SLOTS
        return self._flight.n_slots - 1 - spare

    # -- into the air ---------------------------------------------------------------------------------------------

    async def _swap(self, plan: Plan) -> None:
        swap = Swap(
            self._flight,
            self._incident.log,
            self._shared.metrics,
            self._shared.settings.swap_attempts,
            keeps_stream=self._incident.cause == "extended",
        )
        results = await swap.into(plan)
        flying = [uav for uav, error in results.items() if error is None]
        outcome = "flying" if len(flying) == len(results) else "partly_flying" if flying else "failed"
        self._update(
            outcome=outcome,
            upload_s=swap.seconds,
            in_force_at_s=swap.in_force_at_s,
            vehicles=results,
            error=None if outcome == "flying" else "not every survivor confirmed its new mission",
        )
        if flying:
            await self._incident.log.step(Step.FLYING, plan_id=plan.id, vehicles=results)

    def _update(self, **changes: Any) -> None:
        self.report = self.report.model_copy(update=changes)
