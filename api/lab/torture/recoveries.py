"""What must hold of what is done about losses: once and soon, in order, and as it is said to be."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.losses import LOSS_KINDS
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.lab.torture.checks import at_end, meanwhile
from skyfolio.api.lab.torture.losses import is_verdict
from skyfolio.api.lab.torture.missions import assigned_mission
from skyfolio.api.lab.torture.sightings import Noted, Reported
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.sim import Mode

RECOVERED_S = 20.0
"""Seconds from a verdict to the end of what is done about it, while nothing excuses a delay."""
INSISTING_S = 45.0
"""The same where vehicles refuse uploads, or store them wrongly: each is tried again."""
LATE_S = 1.0
"""An incident is closed at most so long before its last upload arrives."""
STEPS_S = 0.1
"""What a vehicle receives is dated by the step of the fleet before."""
_FLIES = frozenset({"flying", "partly_flying"})
_PLANNED_IN = frozenset({"flying", "paused", "link_lost"})
"""States of an operation in which there may be slots left to plan."""
_NOT_MADE_YET = re.compile(r"is (queued|running) and has no result")
"""Why a plan is refused that is asked for before it is there."""


# -- what is done about them -------------------------------------------------------------------------------------------


@at_end
def _every_incident_is_closed_once(seen: Seen) -> Iterator[str]:
    """Close every incident once: an open one is not dealt with, and a second end contradicts the first."""
    closed = Counter(entry.incident for entry in seen.journal if entry.step is Step.CLOSED)
    for incident in sorted({entry.incident for entry in seen.journal}):
        if closed[incident] != 1:
            yield f"incident {incident} is closed {closed[incident]} times"


@at_end
def _every_incident_is_reported(seen: Seen) -> Iterator[str]:
    """Report every incident once: clients see reports, and not the journal."""
    if seen.end is None:
        return
    reported = Counter(report.incident for report in seen.end.recoveries)
    for incident in sorted({entry.incident for entry in seen.journal} | set(reported)):
        if reported[incident] != 1:
            yield f"incident {incident} is reported {reported[incident]} times"


@at_end
def _every_loss_is_dealt_with_once(seen: Seen) -> Iterator[str]:
    """Deal with each loss once: one that is never taken off the list is planned for again at every restart."""
    losses = Counter(event.data["uav_id"] for event in seen.events if event.kind == "uav_lost")
    dealt = Counter(uav for one in seen.reports.values() if one.ends_it for uav in one.report.lost)
    for uav, times in dealt.items():
        if times > losses[uav]:
            yield f"{uav} was lost {losses[uav]} times, and that was dealt with {times} times"


@at_end
def _survivors_are_on_a_plan_soon_after_a_verdict(seen: Seen) -> Iterator[str]:
    """Deal with every loss, and soon: the users of a lost UAV have nothing until the others fly a new plan.

    Time does not count while the service is dead or settles, the disk or the workers do not work, nothing is planned
    because the operation is paused or no vehicle is heard, or one that counts is not heard well. With another policy
    it is for the operator to say when, and whether.
    """
    if seen.drill.policy != "auto":
        return
    limit_s = INSISTING_S if seen.refusing else RECOVERED_S
    own = seen.own_noted
    times: Counter[str] = Counter()
    for number, noted in enumerate(own):
        if noted.event.kind != "uav_lost":
            continue
        uav = noted.event.data["uav_id"]
        report = _report_of(seen, uav, times[uav])
        times[uav] += 1
        over = _no_longer_matters(seen, own, number)
        until = over if report is None or over.at_s < report.at_s else report
        took_s = until.at_s - noted.at_s - (until.excused_s - noted.excused_s)
        if took_s > limit_s:
            what = "nothing was done about it" if report is None else f"it was {report.report.outcome}"
            yield f"{uav} was lost at {noted.at_s:.1f} s: {what} after {took_s:.0f} s"


def _report_of(seen: Seen, uav: str, losses_before: int) -> Reported | None:
    """Return the report of what was done about a loss of a UAV; None if nothing was.

    Each loss is dealt with once, in turn. It may be dealt with before it is announced: events wait for a full disk.
    """
    reports = [one for one in seen.reports.values() if one.ends_it and uav in one.report.lost]
    return reports[losses_before] if losses_before < len(reports) else None


def _no_longer_matters(seen: Seen, own: list[Noted], loss: int) -> Noted:
    """Return the event after which nothing is planned any more: the last slot, an end, or the loss of the last UAV.

    That is the loss itself if the last slot was over before.
    """
    states = [one.event.data["state"] for one in own[:loss] if one.event.kind == "operation"]
    if states and states[-1] not in _PLANNED_IN:
        return own[loss]
    lost = {one.event.data["uav_id"] for one in own[:loss] if one.event.kind == "uav_lost"}
    for noted in own[loss:]:
        event = noted.event
        if event.kind == "operation" and event.data["state"] not in _PLANNED_IN:
            return noted
        if event.kind == "uav_lost":
            lost.add(event.data["uav_id"])
            if lost == set(seen.uavs):
                return noted
    return own[-1]


@at_end
def _nothing_is_flown_that_the_operator_has_not_approved(seen: Seen) -> Iterator[str]:
    """Ask where the policy says so: the operator who declined a plan does not expect to see it flown."""
    if seen.drill.policy == "auto":
        return
    causes = {one.entry.incident: one.entry.data.get("cause") for one in seen.taken if one.entry.step is Step.DETECTED}
    approved: set[int] = set()
    for one in seen.taken:
        incident = one.entry.incident
        if one.entry.step is Step.APPROVED:
            approved.add(incident)
        if one.entry.step is Step.UPLOADING and causes.get(incident) in LOSS_KINDS and incident not in approved:
            yield f"incident {incident} sends a plan to {one.entry.uav_id} that was not approved"


@at_end
def _nothing_is_sent_to_who_is_lost(seen: Seen) -> Iterator[str]:
    """Plan without a UAV that is lost: it is not ours to command, and users would wait for it."""
    for one in seen.taken:
        began_s = seen.incident(one.entry.incident, Step.REPLANNED)
        if one.entry.step is Step.UPLOADING and began_s is not None:
            uav = str(one.entry.uav_id)
            if _was_lost(seen, uav, began_s):
                yield f"incident {one.entry.incident} sends to {uav}, which was lost before"


def _was_lost(seen: Seen, uav: str, then_s: float) -> bool:
    """Return whether a UAV had been declared lost by then, and was not readmitted since."""
    lost_s = max((one.at_s for one in seen.noted if is_verdict(one, uav) and one.at_s < then_s), default=None)
    if lost_s is None:
        return False
    asked_s = [one.at_s for one in seen.struck if one.blow.kind == "readmit" and one.blow.options.get("uav") == uav]
    planned_s = [
        one.at_s
        for one in seen.taken
        if one.entry.step is Step.DETECTED and one.entry.data.get("cause") == "uav_returned" and one.at_s <= then_s
    ]
    return not any(lost_s < asked <= planned for asked in asked_s for planned in planned_s)


@at_end
def _plans_begin_with_a_slot_that_is_not_flown_yet(seen: Seen) -> Iterator[str]:
    """Change no slot that is being flown: the UAVs cannot be where a new plan would have them at its beginning."""
    slot_s = seen.ground.scenario.slot_duration_s
    for entry in seen.journal:
        at_slot = entry.data.get("at_slot")
        if entry.step is not Step.REPLANNED or at_slot is None or entry.elapsed_s is None:
            continue
        if at_slot * slot_s < entry.elapsed_s:
            yield f"incident {entry.incident} plans from slot {at_slot} on at {entry.elapsed_s:.1f} s"


@at_end
def _plans_are_awaited(seen: Seen) -> Iterator[str]:
    """Wait for a plan until it is made: one that is asked for too soon is none, and the loss is not dealt with."""
    for entry in seen.journal:
        if entry.step is Step.REFUSED and _NOT_MADE_YET.search(str(entry.data.get("error"))):
            yield f"incident {entry.incident}: {entry.data['error']}"


@at_end
def _nothing_is_sent_twice(seen: Seen) -> Iterator[str]:
    """Send nothing twice: a command in doubt is closed, never sent again, as it may have taken effect."""
    sent = Counter(
        (entry.incident, entry.uav_id, entry.data.get("plan_id"), entry.data.get("attempt"))
        for entry in seen.journal
        if entry.step is Step.UPLOADING
    )
    for (incident, uav, plan_id, attempt), times in sent.items():
        if times > 1:
            yield f"incident {incident}: attempt {attempt} to send {plan_id} to {uav} was made {times} times"


@at_end
def _nothing_is_sent_again_after_a_restart(seen: Seen) -> Iterator[str]:
    """Begin a new incident after a restart: what the last service was sending is in doubt, and not to be repeated."""
    for start_s in seen.starts_s[1:]:
        before = max((one.entry.incident for one in seen.taken if one.at_s < start_s), default=0)
        for one in seen.taken:
            if one.at_s >= start_s and one.entry.step is Step.UPLOADING and one.entry.incident <= before:
                yield f"incident {one.entry.incident} sends to {one.entry.uav_id} after the restart at {start_s:.1f} s"


@meanwhile
def _missions_are_sent_after_the_journal_has_them(seen: Seen) -> Iterator[str]:
    """Write into the journal first: a restart knows of a command only from there.

    What is sent on the ground is no part of an incident: a restart gives up an operation that has not taken off.
    """
    for at_s, system_id, message in seen.received:
        is_upload = message.get_type() == "MISSION_COUNT" and message.mission_type == 0
        if not is_upload or seen.uav_of(system_id) not in seen.uavs:
            continue
        if not seen.is_aloft(seen.ground.fleet.vehicles[system_id]):
            continue
        taken = seen.last_taken(Step.UPLOADING, seen.uav_of(system_id), until_s=at_s + STEPS_S)
        closed_s = None if taken is None else seen.incident(taken.entry.incident, Step.CLOSED)
        if taken is None or (closed_s is not None and closed_s < at_s - LATE_S):
            yield f"vehicle {system_id} is sent {message.count} items, and no step of the journal says so"


@at_end
def _nothing_is_broken_off_once_it_is_sent(seen: Seen) -> Iterator[str]:
    """Finish a recovery that sends: one that is broken off leaves some UAVs in the new plan and some in the old."""
    sent = {one.entry.incident for one in seen.taken if one.entry.step is Step.UPLOADING}
    for one in seen.reports.values():
        if one.report.outcome == "superseded" and one.report.incident in sent:
            yield f"incident {one.report.incident} has sent missions, and is {one.report.error}"


# -- what is said of it ------------------------------------------------------------------------------------------------


@meanwhile
def _who_is_said_to_fly_a_new_plan_does(seen: Seen) -> Iterator[str]:
    """Say that a UAV flies a new plan when it does: operators and users rely on it, and so does the next replan.

    It is judged of UAVs in the air that nothing has taken from the service, and that are sent nothing newer by now.
    """
    for one in seen.new_reports:
        report = one.report
        if report.outcome not in _FLIES or seen.state != "flying":
            continue
        failed = [uav for uav, error in report.vehicles.items() if error is not None]
        if failed and report.outcome == "flying":
            yield f"incident {report.incident} is flying, and {', '.join(failed)} is not"
        for uav in report.vehicles.keys() - set(failed):
            vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
            if not seen.is_ours(uav) or not seen.is_aloft(vehicle) or _is_sent_a_newer_one(seen, uav, report.incident):
                continue
            assigned = assigned_mission(seen, vehicle)
            if assigned is None or assigned.first_slot != report.at_slot or not seen.follows_a_plan(vehicle):
                flown = "none of its missions" if assigned is None else f"the plan from slot {assigned.first_slot} on"
                yield f"{uav} has {flown} in mode {vehicle.mode.name}, not the plan from slot {report.at_slot} on"


@meanwhile
def _what_is_flown_counts_after_a_restart(seen: Seen) -> Iterator[str]:
    """Ask the vehicles before a recovery counts as interrupted: what all of them fly is not to be planned again.

    What was verified before the restart, that is: a mission that is found on board only then may be flown later.
    """
    for one in seen.new_reports:
        if one.report.outcome != "interrupted" or seen.state != "flying":
            continue
        steps = [taken.entry for taken in seen.taken if taken.entry.incident == one.report.incident]
        sent = {str(entry.uav_id) for entry in steps if entry.step is Step.UPLOADING}
        proven = [entry for entry in steps if entry.step is Step.VERIFIED and not entry.data.get("after_restart")]
        verified = {str(entry.uav_id) for entry in proven}
        if sent and sent <= verified and all(_flies_its_plan(seen, uav, one.report) for uav in sent):
            yield f"incident {one.report.incident} is interrupted, and {', '.join(sorted(sent))} fly its plan"


def _flies_its_plan(seen: Seen, uav: str, report: RecoveryReport) -> bool:
    vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
    assigned = assigned_mission(seen, vehicle)
    flies = assigned is not None and assigned.first_slot == report.at_slot and vehicle.mode is Mode.MISSION
    return flies and seen.is_ours(uav)


def _is_sent_a_newer_one(seen: Seen, uav: str, incident: int) -> bool:
    """Return whether a later recovery has begun to send this UAV its mission."""
    sent = seen.last_taken(Step.UPLOADING, uav)
    return sent is not None and sent.entry.incident > incident


@at_end
def _the_plan_that_is_flown_is_in_force(seen: Seen) -> Iterator[str]:
    """Put the plan into force that is flown: rates, slips and the next plan are counted by it."""
    if seen.end is None:
        return
    for report in seen.end.recoveries:
        if report.outcome in _FLIES and report.plan_id not in seen.end.plan_ids:
            yield f"{report.plan_id} is flown, and in force were {', '.join(seen.end.plan_ids)}"
