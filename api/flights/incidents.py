"""The changes of one operation in flight, answered one at a time: losses, returns, and doubt after a restart."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, Literal

import structlog

from skyfolio.api.common.errors import ConflictError, NotFoundError
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.journal import IncidentLog, Journal, Step
from skyfolio.api.flights.losses import LOSS_KINDS, Loss, LossKind
from skyfolio.api.flights.operation_views import Policy
from skyfolio.api.flights.recovery import Incident, Parts, Recovery, RecoveryReport
from skyfolio.api.store.event_log import EventLog
from skyfolio.planner import Plan

log = structlog.get_logger()
Cause = LossKind | Literal["uav_returned", "retuned"]


async def _nowhere() -> None:
    """Save nothing."""


class Incidents:
    """What happened, what is being answered, and what waits for it.

    A loss while an answer is still thinking ends that answer, and both losses are answered together; once missions
    are on their way the answer is finished first. `pending` is stored until its answer is.
    """

    def __init__(
        self, operation_id: str, policy: Policy, flight: Flight, parts: Parts, journal: Journal, events: EventLog
    ) -> None:
        self.reports: list[RecoveryReport] = []
        self.pending: dict[str, float] = {}
        self.number = 0
        self.save: Callable[[], Awaitable[None]] = _nowhere
        self._operation_id, self._policy = operation_id, policy
        self._flight, self._parts = flight, parts
        self._journal, self._events = journal, events
        self._wanted: Cause | None = None
        self._readmitted: tuple[str, ...] = ()
        self._offered: set[str] = set()
        self._low: set[str] = set()
        self._incident: Incident | None = None
        self._answer: Recovery | None = None
        self._task: asyncio.Task[RecoveryReport] | None = None
        self._ahead: asyncio.Task[None] | None = None

    @property
    def has_work(self) -> bool:
        """Whether an answer is wanted or being made."""
        return self._wanted is not None or self._task is not None

    @property
    def proposal(self) -> tuple[int, Plan, dict[str, float]] | None:
        """(incident, plan, lost) that waits for the operator."""
        incident = self._incident
        if incident is None or incident.proposed is None:
            return None
        return incident.log.number, incident.proposed, incident.lost

    # -- what happens ---------------------------------------------------------------------------------------------

    async def note(self, lost: dict[str, Loss]) -> None:
        """Take in new losses, and who came back."""
        for uav, loss in lost.items():
            self._parts.metrics.losses.labels(loss.kind).inc()
            self._events.add(
                "uav_lost",
                operation_id=self._operation_id,
                uav_id=uav,
                cause=loss.kind,
                detail=loss.detail,
                silent_for_s=round(loss.silent_for_s, 3),
            )
            if self._policy != "off":
                self.pending[uav] = loss.silent_for_s
                self._wanted = loss.kind
        for uav in sorted(self._flight.returned - self._offered):
            self._parts.metrics.returns.inc()
            self._events.add("uav_returned", operation_id=self._operation_id, uav_id=uav)
        low = self._flight.roster.low_on_battery
        for uav in sorted(low.keys() - self._low):
            self._events.add(
                "uav_low_on_battery", operation_id=self._operation_id, uav_id=uav, detail=low[uav], offer="retire"
            )
        self._low |= low.keys()
        changed = self._flight.returned != self._offered
        self._offered = set(self._flight.returned)
        if lost and self._policy != "off":
            self._parts.ahead.yield_to_flight()
        if lost or changed:
            await self.save()

    async def go_on(self, *, may_start: bool) -> None:
        """Collect a finished answer, end one that a new loss has overtaken, begin the next."""
        if self._task is not None and self._task.done():
            await self._collect(self._task.result())
        if self._task is not None and self._incident is not None:
            overtaken = self._wanted is not None and not self._incident.log.sending
            if overtaken:
                await self.supersede("another loss")
        if self._task is None and may_start:
            if self._wanted is not None:
                await self._begin(self._wanted)
            else:
                self._plan_ahead()

    def want(self, cause: Cause, readmitted: tuple[str, ...] = ()) -> None:
        """Ask for an answer that no loss asks for."""
        self._wanted, self._readmitted = cause, readmitted

    async def supersede(self, why: str) -> None:
        """End an answer before anything was sent; what it was about stays pending. Waits for one that is sending."""
        task, answer = self._task, self._answer
        if task is None or answer is None or self._incident is None:
            return
        if self._incident.log.sending:
            await asyncio.wait([task])
            await self._collect(task.result())
            return
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        self._wanted = self._wanted or self._incident.cause
        await answer.close(outcome="superseded", error=f"superseded by {why}")
        await self._keep(answer.report)

    async def link_lost(self) -> None:
        """Nobody is heard: an answer that has sent nothing yet is begun anew when they are; one that sends runs out."""
        if self._incident is not None and not self._incident.log.sending:
            await self.supersede("our own link being lost")

    # -- what the operator says -----------------------------------------------------------------------------------

    def decide(self, incident: int, *, agreed: bool) -> None:
        """Approve or decline the proposal of that incident. Raises NotFoundError, ConflictError."""
        if incident > self.number or incident < 1:
            raise NotFoundError(f"incident {incident} does not exist")
        current = self._incident
        if current is None or current.log.number != incident or current.approval is None or current.approval.done():
            raise ConflictError(f"incident {incident} has no proposal that waits for an answer")
        current.approval.set_result(agreed)

    async def readmit(self, uav_id: str) -> None:
        """Plan for a UAV again that is back. Raises ConflictError when it was not offered."""
        if uav_id not in self._flight.returned:
            raise ConflictError(f"uav_id: {uav_id!r} has not returned")
        if self._task is not None or self._wanted is not None:
            raise ConflictError("an incident is being answered; wait until it is closed")
        self._flight.roster.readmit(uav_id)
        self._offered.discard(uav_id)
        self.want("uav_returned", (uav_id,))
        await self.save()

    async def retire(self, uav_id: str) -> None:
        """Send a UAV home and plan without it, as after a loss. Raises ConflictError when it is not ours to command."""
        if uav_id not in self._flight.systems:
            raise ConflictError(f"uav_id: {uav_id!r} does not fly in this operation")
        await self.note({uav_id: await self._flight.roster.retire(uav_id)})

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _begin(self, cause: Cause) -> None:
        self._wanted = None
        if self._flight.past_last_slot() or not self._flight.surviving():
            self.pending.clear()
            return
        self.number += 1
        steps = IncidentLog(self._journal, self._operation_id, self.number, self._flight.now_s)
        ask = self._policy == "approve" and cause in LOSS_KINDS
        self._incident = Incident(steps, cause, dict(self.pending), ask=ask, readmitted=self._readmitted)
        self._readmitted = ()
        await self.save()
        self._answer = Recovery(self._parts, self._flight, self._incident)
        self._task = asyncio.create_task(self._answered(self._answer, self._incident))

    async def _answered(self, answer: Recovery, incident: Incident) -> RecoveryReport:
        await incident.log.step(Step.DETECTED, cause=incident.cause, lost=incident.lost)
        await incident.log.step(Step.CLASSIFIED, evidence={uav: self._evidence(uav) for uav in incident.lost})
        try:
            return await answer.run()
        except Exception as error:
            log.exception("answer broke")  # the survivors fly on with the last good plan
            await answer.close(outcome="failed", error=f"{type(error).__name__}: {error}")
            return answer.report

    def _evidence(self, uav: str) -> dict[str, Any]:
        """What was last known of a lost UAV."""
        said = self._flight.on_board(uav)
        seen = {} if said is None else {"mode": said.mode.value, "relative_alt_m": said.relative_alt_m}
        loss = self._flight.roster.losses.get(uav)
        verdict = {} if loss is None else {"verdict": loss.kind, "detail": loss.detail}
        return {**verdict, "since_s": round(self._flight.lost.get(uav, 0.0), 3), **seen}

    async def _collect(self, report: RecoveryReport) -> None:
        for uav in report.lost:
            self.pending.pop(uav, None)
        await self._keep(report)

    async def _keep(self, report: RecoveryReport) -> None:
        self._task = self._answer = self._incident = None
        self.reports.append(report)
        await self.save()
        self._events.add("recovery", operation_id=self._operation_id, **report.model_dump(mode="json"))

    def _plan_ahead(self) -> None:
        """Use idle time: plans for each single loss at the slots that come next."""
        flight, parts = self._flight, self._parts
        if not parts.settings.plan_ahead or self._policy == "off" or len(flight.plan.scenario.uavs) < 2:
            return
        if self._ahead is None or self._ahead.done():
            self._ahead = asyncio.create_task(self._make_ahead())

    async def _make_ahead(self) -> None:
        flight, parts = self._flight, self._parts
        lead_slots = (parts.settings.guidance_lead_s * parts.clock.scale + flight.now_s()) / flight.slot_s
        for at_slot in (int(lead_slots) + 1, int(lead_slots) + 2):
            if at_slot < flight.n_slots - 1:
                try:
                    await parts.ahead.make(flight.plan, at_slot, flight.plan.scenario.uav_ids)
                except Exception as error:  # noqa: BLE001 - what is made in idle time must not end the flight
                    log.warning("no plan ahead", at_slot=at_slot, error=str(error))
                    return
        await asyncio.sleep(0.2)

    async def close(self, why: str) -> None:
        """The operation is over: an answer that is not complete is closed as unanswered, and says why."""
        task, answer = self._task, self._answer
        if task is None or answer is None:
            return
        if not task.done():
            await self.end()
        if task.cancelled():
            await answer.close(outcome="unanswered", error=f"not answered: {why}")
        await self._collect(answer.report)

    async def end(self) -> None:
        """Stop answering. What is open stays open in the books, for `close`, or for the next service to go on with."""
        tasks = [task for task in (self._task, self._ahead) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    # -- for a restart --------------------------------------------------------------------------------------------

    def document(self) -> dict[str, Any]:
        """What a restart needs."""
        return {
            "incident": self.number,
            "pending": self.pending,
            "wanted": self._wanted or (self._incident.cause if self._incident else None),
            "readmitted": list(self._incident.readmitted if self._incident else self._readmitted),
            "recoveries": [report.model_dump(mode="json") for report in self.reports],
        }

    def recall(self, document: dict[str, Any]) -> None:
        """Take over what a stopped service has stored."""
        self.number = document["incident"]
        self.pending = document["pending"]
        self._wanted = document["wanted"] or ("heartbeat_lost" if self.pending else None)
        self._readmitted = tuple(document["readmitted"])
        self._offered = set(document["returned"])
        self.reports = [RecoveryReport.model_validate(report) for report in document["recoveries"]]

    def settled(self, report: RecoveryReport) -> None:
        """A restart has found out how an interrupted answer ended."""
        self.reports.append(report)
        if report.outcome not in {"interrupted", "superseded"}:
            self.pending = {uav: silent for uav, silent in self.pending.items() if uav not in report.lost}
            self._wanted = self._wanted if self.pending else None
