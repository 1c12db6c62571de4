"""After a restart: what a stopped service left in the air, and what became of the commands that it was sending.

Nothing is sent before the vehicles have reported what they fly. A command in doubt is closed, never sent again: if it
took effect the journal is completed, if not the incident is dealt with again, from where the vehicles then are.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable
from typing import Any, TypeAlias

import structlog
from sqlalchemy import Row, select

from skyfolio.api.common.surroundings import utc_now
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.endless.horizon import terms_in
from skyfolio.api.flights.endless.long_record import LongRecord
from skyfolio.api.flights.endless.pool import Pool
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.journal import Entry, Step, last_incident
from skyfolio.api.flights.losses import Loss
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_store import OperationIdentity, Stores
from skyfolio.api.flights.operation_views import IN_THE_AIR, State
from skyfolio.api.flights.rates import InForce
from skyfolio.api.flights.recovery_report import Outcome, RecoveryReport, changes_of
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.store.tables import track as track_table
from skyfolio.mavlink_bridge import OnEnd
from skyfolio.planner import Plan
from skyfolio.planner.geometry import Point

log = structlog.get_logger()
Record: TypeAlias = list[tuple[float, dict[str, Point]]]


async def restored(
    row: Row[Any], shared: SharedServices, stores: Stores, fleet: Fleet, *, with_track: bool = True
) -> Operation:
    """Return an operation as it was last stored, with its slot clock where it is now, and the record of its flight."""
    document = json.loads(row.document)
    timeline = [
        InForce(entry["from_s"], await shared.plans.finished(entry["plan_id"])) for entry in document["timeline"]
    ]
    options = GuidanceOptions(at_end=OnEnd(document.get("at_end", OnEnd.LAND)))  # by missions: the stream has ended
    terms, extensions = terms_in(document["endless"]) if document.get("endless") else (None, 0)
    pool = Pool.restored(document["pool"], timeline[0].plan) if document.get("pool") else None
    flight = Flight(timeline[0].plan, document["vehicles"], fleet, shared.clock, options, terms, pool)
    flight.restore_plans(timeline)
    losses = {uav: Loss(**loss) for uav, loss in document.get("losses", {}).items()}
    flight.roster.restore(document["lost"], losses, set(document["returned"]), set(document.get("retired", [])))
    if document["paused_s"] is not None:
        flight.set_slot_clock(document["paused_s"], paused=True)
    elif document["slot0_at"] is not None:
        flight.set_slot_clock(shared.clock.since_utc(document["slot0_at"]))
    if flight.horizon is not None:
        flight.horizon.extensions = extensions
        flight.forget_before(await LongRecord(stores.database, row.id, flight).stored_slots())
    if with_track:
        after_s = flight.rates_from_slot * flight.slot_s or None
        flight.restore(await stored_track(row.id, stores, after_s))
    identity = OperationIdentity(
        id=row.id,
        number=row.number,
        policy=row.policy,
        created_at=row.created_at,
        fingerprint=row.fingerprint,
        launch_itself=document["launch_itself"],
        disruption_weight=document.get("disruption_weight", 0.0),
    )
    operation = Operation(identity, flight, shared, stores)
    operation.state, operation.version, operation.error = State(row.state), row.version, document["error"]
    operation.incidents.restore(document)
    serving = [
        InForce(entry["from_s"], await shared.plans.finished(entry["plan_id"])) for entry in document.get("serving", [])
    ]
    await operation.radio.restore(document.get("allocation_revision", 0), serving)
    flight.guidance.was_streaming = document.get("streams", False)
    await flight.guidance.restore(document.get("ghosts", []))
    operation.mark_track_stored()
    return operation


async def settle(operation: Operation) -> None:
    """Find out which commands took effect, and decide how to go on; the vehicles have been heard, or are silent."""
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
        operation.flight.recall_who_flew()
        await _settle_flight(operation)


async def _give_up(operation: Operation, state: State, why: str) -> None:
    entries = await _unreported_entries(operation)
    if entries:
        report = _report_from(entries, "unanswered", f"not completed: {why}")
        await _close(operation, entries, report)
    operation.error = why
    await operation.enter(state)


async def _unreported_entries(operation: Operation) -> list[Entry]:
    """Return the entries of an incident that was going on, or just over, when the service was stopped."""
    entries = last_incident(await operation.journal.of(operation.id))
    reported = {report.incident for report in operation.incidents.reports}
    return entries if entries and entries[0].incident not in reported else []


def _report_from(entries: list[Entry], outcome: Outcome, error: str | None) -> RecoveryReport:
    """Return what the journal says of an incident: as it was closed, if it was, else with this outcome and error."""
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
    """Write the last step unless it is written, and keep the report."""
    if entries[-1].step is not Step.CLOSED:
        await _write(operation, report.incident, Step.CLOSED, {"outcome": report.outcome, "error": report.error})
    operation.incidents.record_interrupted(report)


async def _settle_flight(operation: Operation) -> None:
    entries = await _unreported_entries(operation)
    if entries:
        await _settle_incident(operation, entries)
    operation.replan_if_off_plan()


async def _settle_incident(operation: Operation, entries: list[Entry]) -> None:
    """Complete the journal of a recovery that was interrupted; losses that it did not deal with stay pending."""
    sent = {entry.uav_id: entry for entry in entries if entry.step is Step.UPLOADING and entry.uav_id}
    took_effect = {uav for uav, entry in sent.items() if _took_effect(operation, entries, entry)}
    flying = {uav for uav in took_effect if _in_mission(operation, uav)}
    survivors = set(operation.flight.surviving())
    plan_id = next((entry.data["plan_id"] for entry in sent.values()), None)
    if took_effect and plan_id is not None:
        await _put_into_force(operation, entries, plan_id, took_effect)
    done = bool(sent) and set(sent) & survivors == flying & survivors and bool(flying)
    interrupted = "the service was stopped before the recovery was complete"
    journaled = _report_from(entries, "flying", None) if done else _report_from(entries, "interrupted", interrupted)
    in_doubt = {uav: None if uav in flying else "in doubt when the service was stopped" for uav in sent}
    report = journaled.model_copy(
        update={
            "plan_id": plan_id,
            **(changes_of(operation.flight.plan) if operation.flight.plan.id == plan_id else {}),
            "in_force_at_s": operation.flight.timeline[-1].from_s if took_effect else None,
            "vehicles": _outcome_of_each(entries) or in_doubt,
        }
    )
    if done and not any(entry.step is Step.FLYING for entry in entries):
        await _write(operation, report.incident, Step.FLYING, {"plan_id": plan_id, "vehicles": report.vehicles})
    await _close(operation, entries, report)
    await operation.save()


def _outcome_of_each(entries: list[Entry]) -> dict[str, str | None] | None:
    """Return what the journal of a recovery that was closed says of each UAV; None if it was not closed."""
    if entries[-1].step is not Step.CLOSED:
        return None
    return next((entry.data["vehicles"] for entry in reversed(entries) if entry.step is Step.FLYING), None)


def _took_effect(operation: Operation, entries: list[Entry], sent: Entry) -> bool:
    """Return whether an upload is on board: it was verified, or the vehicle reports another mission than before."""
    if any(entry.step is Step.VERIFIED and entry.uav_id == sent.uav_id for entry in entries):
        return True
    telemetry = operation.flight.telemetry(str(sent.uav_id))
    if telemetry is None:
        return False
    if telemetry.mission_id and sent.data["mission_id_before"]:
        return bool(telemetry.mission_id != sent.data["mission_id_before"])
    return bool(telemetry.mission_total == sent.data["items"] != sent.data["items_before"])


async def _put_into_force(operation: Operation, entries: list[Entry], plan_id: str, uavs: set[str]) -> None:
    """Put the new plan into force, since UAVs fly it, and note which of them do."""
    if operation.flight.plan.id != plan_id:
        plan: Plan = await operation.shared.plans.finished(plan_id)
        times_s = [entry.elapsed_s for entry in entries if entry.step in {Step.VERIFIED, Step.UPLOADING}]
        operation.flight.take_over_since(max(at_s or 0.0 for at_s in times_s), plan)
    verified = {entry.uav_id for entry in entries if entry.step is Step.VERIFIED}
    for uav in sorted(uavs - verified):
        await _write(operation, entries[0].incident, Step.VERIFIED, {"plan_id": plan_id, "after_restart": True}, uav)


async def _write(operation: Operation, incident: int, step: Step, data: dict[str, Any], uav: str | None = None) -> None:
    entry = Entry(
        operation_id=operation.id,
        incident=incident,
        step=step,
        uav_id=uav,
        at=utc_now(),
        elapsed_s=operation.flight.elapsed_s(),
        data=data,
    )
    await operation.journal.write(entry)


def _all_started(operation: Operation) -> bool:
    """Return whether every vehicle that is heard flies its mission; one that is silent is lost like any other."""
    flight = operation.flight
    heard = [uav for uav in flight.plan.scenario.uav_ids if flight.telemetry(uav) is not None]
    return bool(heard) and all(_in_mission(operation, uav) for uav in heard)


def _in_mission(operation: Operation, uav: str) -> bool:
    telemetry = operation.flight.telemetry(uav)
    return telemetry is not None and telemetry.mode.value == "mission"


async def stored_track(
    operation_id: str, stores: Stores, after_s: float | None = None, limit: int | None = None
) -> Record:
    """Return where every UAV of an operation was heard, metres east/north, the oldest sample first.

    Samples have their fleet seconds since slot 0. after_s: only later ones. limit: at most so many.
    """
    query = select(track_table).where(track_table.c.operation_id == operation_id)
    if after_s is not None:
        query = query.where(track_table.c.elapsed_s > after_s)
    return await asyncio.to_thread(
        _record, await stores.database.rows(query.order_by(track_table.c.elapsed_s, track_table.c.id).limit(limit))
    )


def _record(rows: Iterable[Row[Any]]) -> Record:
    return [
        (row.elapsed_s, {uav: (east, north) for uav, (east, north) in json.loads(row.positions).items()})
        for row in rows
    ]
