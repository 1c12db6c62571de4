"""The incidents of one operation, dealt with one at a time: losses, returns, retunings, and doubt after a restart."""

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
from skyfolio.api.flights.operation_store import OperationIdentity
from skyfolio.api.flights.plans_ahead import PlansAhead
from skyfolio.api.flights.recovery import Incident, Recovery
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.store.event_log import EventLog
from skyfolio.planner import Plan

log = structlog.get_logger()
Cause = LossKind | Literal["uav_returned", "retuned", "rates_off", "extended", "relief"]
ASKED = frozenset({*LOSS_KINDS, "rates_off"})
"""What an operator who wants to approve new plans is asked about; the rest they ordered themselves."""


ROUTINE = frozenset({"extended", "relief"})
MOST_ROUTINE = 20
"""Reports of recoveries that were to extend the plan are kept up to this number: an operation may have thousands. So
are those of reliefs."""


async def _save_nothing() -> None:
    """Stand in for `Incidents.save` until the operation sets it."""


class Incidents:
    """What happened, which recovery is running, and what waits for one.

    A loss ends a recovery that has sent nothing yet, and both losses are dealt with together; once missions are being
    sent the recovery is finished first. `pending` holds the UAVs whose loss has not been dealt with, and for how many
    fleet seconds each was silent when it was declared lost; it is stored until their recovery is closed.
    """

    def __init__(
        self,
        identity: OperationIdentity,
        flight: Flight,
        shared: SharedServices,
        journal: Journal,
        events: EventLog,
    ) -> None:
        self.reports: list[RecoveryReport] = []
        self.pending: dict[str, float] = {}
        self.number = 0
        self.save: Callable[[], Awaitable[None]] = _save_nothing
        self._operation_id, self._policy, self._weight = identity.id, identity.policy, identity.disruption_weight
        self._flight, self._shared = flight, shared
        self._journal, self._events = journal, events
        self._requested: Cause | None = None
        self._readmitted: tuple[str, ...] = ()
        self._detail = ""
        self._reliever: str | None = None
        self._offered_back: set[str] = set()
        self._reported_low: set[str] = set()
        self._incident: Incident | None = None
        self._recovery: Recovery | None = None
        self._task: asyncio.Task[RecoveryReport] | None = None
        self._plans_ahead = PlansAhead(flight, shared, identity.disruption_weight)

    @property
    def has_work(self) -> bool:
        """Return whether a recovery is requested or running."""
        return self._requested is not None or self._task is not None

    @property
    def proposal(self) -> tuple[int, Plan, dict[str, float]] | None:
        """Return incident, plan and losses of the proposal that waits for the operator; None if there is none."""
        incident = self._incident
        if incident is None or incident.proposed is None:
            return None
        return incident.log.number, incident.proposed, incident.lost

    # -- what happens ---------------------------------------------------------------------------------------------

    async def take_in(self, lost: dict[str, Loss]) -> None:
        """Report new losses, UAVs that are back and low batteries; request a recovery from losses."""
        for uav, loss in lost.items():
            self._take_in_loss(uav, loss)
        for uav in sorted(self._flight.returned - self._offered_back):
            self._shared.metrics.returns.inc()
            self._events.add("uav_returned", operation_id=self._operation_id, uav_id=uav)
        low = self._flight.roster.low_on_battery
        for uav in sorted(low.keys() - self._reported_low):
            self._events.add(
                "uav_low_on_battery", operation_id=self._operation_id, uav_id=uav, detail=low[uav], offer="retire"
            )
        self._reported_low |= low.keys()
        changed = self._flight.returned != self._offered_back
        self._offered_back = set(self._flight.returned)
        if lost and self._policy != "off":
            self._shared.contingencies.yield_to_flight()
        if lost or changed:
            await self.save()

    def _take_in_loss(self, uav: str, loss: Loss) -> None:
        self._shared.metrics.losses.labels(loss.kind).inc()
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
            self._requested = loss.kind

    async def advance(self, *, may_start: bool) -> None:
        """Take in a finished recovery, end one that a new loss has overtaken, and begin the next.

        may_start: whether a recovery may be begun now.
        """
        if self._task is not None and self._task.done():
            await self._collect(self._task.result())
        incident = self._incident
        if incident is not None and self._requested is not None and incident.log.may_be_broken_off:
            await self.supersede("another loss")
        if self._task is None and may_start:
            if self._requested is not None:
                await self._begin(self._requested)
            elif self._policy != "off":
                self._plans_ahead.go_on()

    def request_recovery(
        self, cause: Cause, readmitted: tuple[str, ...] = (), detail: str = "", reliever: str | None = None
    ) -> None:
        """Request a recovery for another cause than a loss. reliever: who takes over a station, for `relief`."""
        self._requested, self._readmitted, self._detail, self._reliever = cause, readmitted, detail, reliever

    async def supersede(self, why: str) -> None:
        """End a recovery before anything was sent; its losses stay pending.

        Wait for a recovery that is already sending, and for one that is being closed: it has dealt with its losses.
        """
        task, recovery = self._task, self._recovery
        if task is None or recovery is None or self._incident is None:
            return
        if not self._incident.log.may_be_broken_off:
            await asyncio.wait([task])
            await self._collect(task.result())
            return
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        if self._incident.cause != "relief":  # who hovers asks for another one
            self._requested = self._requested or self._incident.cause
        await recovery.close(outcome="superseded", error=f"superseded by {why}")
        await self._store(recovery.report)

    async def link_lost(self) -> None:
        """End a recovery that has sent nothing yet, so that it is begun again when the link is back.

        A recovery that is sending, or being closed, runs to its end.
        """
        if self._incident is not None and self._incident.log.may_be_broken_off:
            await self.supersede("our own link being lost")

    # -- what the operator decides --------------------------------------------------------------------------------

    def decide(self, incident: int, *, agreed: bool) -> None:
        """Approve or decline the proposal of an incident. Raises NotFoundError, ConflictError."""
        if incident > self.number or incident < 1:
            raise NotFoundError(f"incident {incident} does not exist")
        current = self._incident
        if current is None or current.log.number != incident or current.approval is None or current.approval.done():
            raise ConflictError(f"incident {incident} has no proposal that waits for a decision")
        current.approval.set_result(agreed)

    async def readmit(self, uav_id: str) -> None:
        """Plan again with a UAV that is back.

        Raises ConflictError if it was not offered, or while a recovery is under way.
        """
        if uav_id not in self._flight.returned:
            raise ConflictError(f"uav_id: {uav_id!r} was not lost, or is not heard again")
        if self._task is not None or self._requested is not None:
            raise ConflictError("a recovery is under way; wait until it is closed")
        self._flight.roster.readmit(uav_id)
        self._offered_back.discard(uav_id)
        self.request_recovery("uav_returned", (uav_id,))
        await self.save()

    async def retire(self, uav_id: str, because: str | None = None) -> None:
        """Send a UAV home and plan without it, as after a loss. Raises ConflictError if it may not be commanded.

        because: why the service does so by itself; None where the operator asked for it.
        """
        if uav_id not in self._flight.systems:
            raise ConflictError(f"uav_id: {uav_id!r} does not fly in this operation")
        await self.take_in({uav_id: await self._flight.roster.retire(uav_id, because)})

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _begin(self, cause: Cause) -> None:
        self._requested = None
        if self._flight.past_last_slot() or not self._flight.surviving():
            self.pending.clear()
            return
        self.number += 1
        steps = IncidentLog(self._journal, self._operation_id, self.number, self._flight.now_s)
        self._incident = Incident(
            steps,
            cause,
            dict(self.pending),
            self._weight,
            ask=self._policy == "approve" and cause in ASKED,
            readmitted=self._readmitted,
            detail="" if cause in LOSS_KINDS else self._detail,
            reliever=self._reliever if cause == "relief" else None,
        )
        self._readmitted, self._detail, self._reliever = (), "", None
        await self.save()
        self._recovery = Recovery(self._shared, self._flight, self._incident, self.save)
        self._task = asyncio.create_task(self._recover(self._recovery, self._incident))

    async def _recover(self, recovery: Recovery, incident: Incident) -> RecoveryReport:
        await incident.log.step(Step.DETECTED, cause=incident.cause, lost=incident.lost)
        await incident.log.step(Step.CLASSIFIED, evidence={uav: self._evidence(uav) for uav in incident.lost})
        try:
            return await recovery.run()
        except Exception as error:
            log.exception("recovery failed unexpectedly")  # the survivors fly on with the last good plan
            await recovery.close(outcome="failed", error=f"{type(error).__name__}: {error}")
            return recovery.report

    def _evidence(self, uav: str) -> dict[str, Any]:
        """Return what was last known of a lost UAV."""
        telemetry = self._flight.telemetry(uav)
        reported = (
            {} if telemetry is None else {"mode": telemetry.mode.value, "relative_alt_m": telemetry.relative_alt_m}
        )
        loss = self._flight.roster.losses.get(uav)
        verdict = {} if loss is None else {"verdict": loss.kind, "detail": loss.detail}
        return {**verdict, "since_s": round(self._flight.lost.get(uav, 0.0), 3), **reported}

    async def _collect(self, report: RecoveryReport) -> None:
        for uav in report.lost:
            self.pending.pop(uav, None)
        await self._store(report)

    async def _store(self, report: RecoveryReport) -> None:
        self._task = self._recovery = self._incident = None
        self._keep(report)
        await self.save()
        self._events.add("recovery", operation_id=self._operation_id, **report.model_dump(mode="json"))

    def _keep(self, report: RecoveryReport) -> None:
        """Keep this report, and forget the oldest of those that only extended the plan."""
        self.reports.append(report)
        if report.cause not in ROUTINE:
            return
        if (
            self._flight.horizon is not None
            and report.cause == "extended"
            and report.outcome in {"flying", "partly_flying"}
        ):
            self._flight.horizon.extensions += 1
        alike = [one for one in self.reports if one.cause == report.cause]
        if len(alike) > MOST_ROUTINE:
            self.reports.remove(alike[0])

    async def close(self, why: str) -> None:
        """Close a recovery that is not complete as unanswered, with the reason: the operation is over."""
        task, recovery = self._task, self._recovery
        if task is None or recovery is None:
            return
        if not task.done():
            await self.end()
        if task.cancelled():
            await recovery.close(outcome="unanswered", error=f"not completed: {why}")
        await self._collect(recovery.report)

    async def end(self) -> None:
        """Stop recovering. An open incident stays open in the journal, for `close` or for the next service."""
        tasks = [task for task in (self._task, self._plans_ahead.task) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    # -- for a restart --------------------------------------------------------------------------------------------

    def document(self) -> dict[str, Any]:
        """Return what a restart needs."""
        return {
            "incident": self.number,
            "pending": self.pending,
            "wanted": self._requested or (self._incident.cause if self._incident else None),
            "readmitted": list(self._incident.readmitted if self._incident else self._readmitted),
            "recoveries": [report.model_dump(mode="json") for report in self.reports],
        }

    def restore(self, document: dict[str, Any]) -> None:
        """Take over what a stopped service has stored."""
        self.number = document["incident"]
        self.pending = document["pending"]
        wanted = document["wanted"] if document["wanted"] != "relief" else None  # who hovers asks for another one
        self._requested = wanted or ("heartbeat_lost" if self.pending else None)
        self._readmitted = tuple(document["readmitted"])
        self._offered_back = set(document["returned"])
        self.reports = [RecoveryReport.model_validate(report) for report in document["recoveries"]]

    def record_interrupted(self, report: RecoveryReport) -> None:
        """Take in the report of a recovery that the end of the service interrupted."""
        self._keep(report)
        if report.outcome not in {"interrupted", "superseded"}:
            self.pending = {uav: silent_s for uav, silent_s in self.pending.items() if uav not in report.lost}
            self._requested = self._requested if self.pending else None
