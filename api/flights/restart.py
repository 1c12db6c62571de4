"""After a restart: what a stopped service left in the air, and what became of the commands it was sending.

Nothing is sent before the vehicles have said what they fly. A command in doubt is closed, never sent again: if it
took effect the books are completed, if not the situation is answered anew, from where the vehicles then are.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, TypeAlias

import structlog
from sqlalchemy import Row, select

from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.journal import Entry, Step, last_incident
from skyfolio.api.flights.losses import Loss
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_store import OperationIdentity, Stores
from skyfolio.api.flights.operation_views import IN_THE_AIR, State
from skyfolio.api.flights.rates import InForce, Point
from skyfolio.api.flights.recovery_report import Outcome, RecoveryReport
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.store.tables import track as track_table
from skyfolio.mavlink_bridge import OnEnd
from skyfolio.planner import Plan

log = structlog.get_logger()
Record: TypeAlias = list[tuple[float, dict[str, Point]]]


async def restored(row: Row[Any], shared: SharedServices, stores: Stores, fleet: Fleet) -> Operation:
    """An operation as it was last stored, with its slot clock where it is now."""
    said = json.loads(row.document)
    timeline = [InForce(entry["from_s"], await shared.plans.finished(entry["plan_id"])) for entry in said["timeline"]]
    options = GuidanceOptions(at_end=OnEnd(said.get("at_end", OnEnd.LAND)))  # by missions: the stream has ended
    flight = Flight(timeline[0].plan, said["vehicles"], fleet, shared.clock, options)
    flight.timeline = timeline
    why = {uav: Loss(**loss) for uav, loss in said.get("losses", {}).items()}
    flight.roster.restore(said["lost"], why, set(said["returned"]), set(said.get("retired", [])))
    if said["paused_s"] is not None:
        flight.set_slot_clock(said["paused_s"], paused=True)
    elif said["slot0_at"] is not None:
        flight.set_slot_clock((time.time() - said["slot0_at"]) * shared.clock.scale)
    flight.restore(await stored_track(row.id, stores))
    identity = OperationIdentity(
        id=row.id,
        number=row.number,
        policy=row.policy,
        created_at=row.created_at,
        fingerprint=row.fingerprint,
        launch_itself=said["launch_itself"],
    )
    operation = Operation(identity, flight, shared, stores)
    operation.state, operation.version, operation.error = State(row.state), row.version, said["error"]
    operation.incidents.restore(said)
    await flight.guidance.restore(said.get("ghosts", []))
    operation.mark_track_stored()
    return operation


async def settle(operation: Operation) -> None:
    """Find out what is in doubt, and decide how to go on; the vehicles have been heard, or are silent."""
    if operation.state in {State.UPLOADING, State.READY}:
        await _give_up(operation, State.FAILED, "the service was stopped before take-off; start a new operation")
    elif operation.state == State.STARTING and _all_started(operation):
        await operation.enter(State.FLYING)
    elif operation.state not in IN_THE_AIR:
        await _give_up(
            operation,
            State.INTERRUPTED,
            f"the service was stopped while {operation.state.value}; vehicles were left as they are: abort to end it",
        )
    else:
        await _settle_flight(operation)


async def _give_up(operation: Operation, state: State, why: str) -> None:
    entries = await _untold(operation)
    if entries:
        report = _told(entries, "unanswered", f"not answered: {why}")
        await _close(operation, entries, report)
    operation.error = why
    await operation.enter(state)


async def _untold(operation: Operation) -> list[Entry]:
    """The entries of an incident that was going on, or just over, when the service was stopped."""
    entries = last_incident(await operation.journal.of(operation.id))
    told = {report.incident for report in operation.incidents.reports}
    return entries if entries and entries[0].incident not in told else []


def _told(entries: list[Entry], outcome: Outcome, error: str | None) -> RecoveryReport:
    """What the journal says of an incident; as it was closed, if it was."""
    first, last = entries[0], entries[-1]
    if last.step is Step.CLOSED:
        outcome, error = last.data["outcome"], last.data.get("error")
    return RecoveryReport(
        outcome=outcome,
        incident=first.incident,
        cause=first.data.get("cause", "heartbeat_lost"),
        lost=first.data.get("lost", {}),
        declared_at_s=first.elapsed_s or 0.0,
        at_slot=max((entry.data.get("at_slot", 0) for entry in entries), default=0),
        error=error,
    )


async def _close(operation: Operation, entries: list[Entry], report: RecoveryReport) -> None:
    """Write the last step, if it is not written, and remember the report."""
    if entries[-1].step is not Step.CLOSED:
        await _write(operation, report.incident, Step.CLOSED, {"outcome": report.outcome, "error": report.error})
    operation.incidents.record_interrupted(report)


async def _settle_flight(operation: Operation) -> None:
    entries = await _untold(operation)
    if entries:
        await _settle_incident(operation, entries)
    operation.replan_if_off_plan()


async def _settle_incident(operation: Operation, entries: list[Entry]) -> None:
    """Complete the books of an answer that was interrupted; what is left to answer stays pending."""
    sent = {entry.uav_id: entry for entry in entries if entry.step is Step.UPLOADING and entry.uav_id}
    took = {uav for uav, entry in sent.items() if _took_effect(operation, entries, entry)}
    flies = {uav for uav in took if _in_mission(operation, uav)}
    survivors = set(operation.flight.surviving())
    plan_id = next((entry.data["plan_id"] for entry in sent.values()), None)
    if took and plan_id is not None:
        await _into_force(operation, entries, plan_id, took)
    done = bool(sent) and set(sent) & survivors == flies & survivors and bool(flies)
    stopped = "the service was stopped before the answer was complete"
    told = _told(entries, "flying", None) if done else _told(entries, "interrupted", stopped)
    report = told.model_copy(
        update={
            "plan_id": plan_id,
            "in_force_at_s": operation.flight.timeline[-1].from_s if took else None,
            "vehicles": {uav: None if uav in flies else "in doubt when the service was stopped" for uav in sent},
        }
    )
    if done and not any(entry.step is Step.FLYING for entry in entries):
        await _write(operation, report.incident, Step.FLYING, {"plan_id": plan_id, "vehicles": report.vehicles})
    await _close(operation, entries, report)
    await operation.save()


def _took_effect(operation: Operation, entries: list[Entry], sent: Entry) -> bool:
    """Whether the upload is on board: journaled as verified, or the vehicle reports another mission than before."""
    if any(entry.step is Step.VERIFIED and entry.uav_id == sent.uav_id for entry in entries):
        return True
    said = operation.flight.telemetry(str(sent.uav_id))
    if said is None:
        return False
    if said.mission_id and sent.data["mission_id_before"]:
        return bool(said.mission_id != sent.data["mission_id_before"])
    return bool(said.mission_total == sent.data["items"] != sent.data["items_before"])


async def _into_force(operation: Operation, entries: list[Entry], plan_id: str, took: set[str]) -> None:
    """The new plan is the one that the others now have to fit."""
    if operation.flight.plan.id != plan_id:
        plan: Plan = await operation.shared.plans.finished(plan_id)
        seen = [entry.elapsed_s for entry in entries if entry.step in {Step.VERIFIED, Step.UPLOADING}]
        operation.flight.timeline.append(InForce(max(at or 0.0 for at in seen), plan))
    known = {entry.uav_id for entry in entries if entry.step is Step.VERIFIED}
    for uav in sorted(took - known):
        await _write(operation, entries[0].incident, Step.VERIFIED, {"plan_id": plan_id, "after_restart": True}, uav)


async def _write(operation: Operation, incident: int, step: Step, data: dict[str, Any], uav: str | None = None) -> None:
    entry = Entry(
        operation_id=operation.id,
        incident=incident,
        step=step,
        uav_id=uav,
        at=datetime.now(UTC),
        elapsed_s=operation.flight.elapsed_s(),
        data=data,
    )
    await operation.journal.write(entry)


def _all_started(operation: Operation) -> bool:
    """Whether everybody who is heard flies its mission; who is silent is lost, and answered like any loss."""
    heard = [uav for uav in operation.flight.systems if operation.flight.telemetry(uav) is not None]
    return bool(heard) and all(_in_mission(operation, uav) for uav in heard)


def _in_mission(operation: Operation, uav: str) -> bool:
    said = operation.flight.telemetry(uav)
    return said is not None and said.mode.value == "mission"


async def stored_track(
    operation_id: str, stores: Stores, after_s: float | None = None, limit: int | None = None
) -> Record:
    """Where every UAV of an operation was heard, the oldest first: all, or at most `limit` samples after `after_s`."""
    wanted = select(track_table).where(track_table.c.operation_id == operation_id)
    if after_s is not None:
        wanted = wanted.where(track_table.c.elapsed_s > after_s)
    return await asyncio.to_thread(
        _record, await stores.database.rows(wanted.order_by(track_table.c.elapsed_s, track_table.c.id).limit(limit))
    )


def _record(rows: Iterable[Row[Any]]) -> Record:
    return [
        (row.elapsed_s, {uav: (east, north) for uav, (east, north) in json.loads(row.positions).items()})
        for row in rows
    ]
