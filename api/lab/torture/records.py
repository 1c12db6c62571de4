"""What must hold of what the service writes: events, journal, states, and what is left when all is over."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise, takewhile

from skyfolio.api.flights.operation_views import ENDED, State
from skyfolio.api.lab.torture.checks import afterwards, at_end, meanwhile
from skyfolio.api.lab.torture.sightings import SlotClock
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.sim import Mode

SLOT_CLOCK_S = 0.3
"""How far the slot clock may be from the fleet's."""
FOLLOWS = {
    "uploading": {"ready", "launching", "failed", "aborting"},
    "ready": {"launching", "failed", "aborting"},
    "launching": {"starting", "failed", "aborting", "interrupted"},
    "starting": {"flying", "failed", "aborting", "interrupted"},
    "flying": {"paused", "landing", "link_lost", "completed", "completed_partly", "failed", "aborting"},
    "paused": {"flying", "link_lost", "failed", "aborting", "completed_partly"},
    "landing": {"link_lost", "completed", "completed_partly", "failed", "aborting"},
    "link_lost": {"flying", "paused", "landing", "completed", "completed_partly", "failed", "aborting"},
    "aborting": {"aborted"},
    "interrupted": {"aborting"},
}
"""Which states may follow which; a state may be reported again, with what went wrong."""
_UNFORESEEN = re.compile(r"\b(?!TimeoutError)\w+(Error|Exception): ")


@at_end
def _every_operation_ends(seen: Seen) -> Iterator[str]:
    """End every operation: one that never ends keeps its vehicles, and its operator, for ever."""
    if seen.end is None or seen.end.state not in ENDED:
        state = "unknown" if seen.end is None else seen.end.state.value
        yield f"it is {state} {seen.ground.now_s:.0f} s after the start"


@at_end
def _states_follow_each_other(seen: Seen) -> Iterator[str]:
    """Let states follow each other as documented: an operation that was aborted does not fly again."""
    states = [event.data["state"] for event in filter(seen.is_own, seen.events) if event.kind == "operation"]
    for before, after in pairwise(states):
        if after != before and after not in FOLLOWS.get(before, set()):
            yield f"{before} is followed by {after}"


@at_end
def _an_operation_ends_once(seen: Seen) -> Iterator[str]:
    """End an operation once, unless it is ordered again: of two orders that end it only the newest closes it."""
    ends = [noted for noted in seen.own_noted if noted.event.kind == "operation" and noted.event.data.get("ends")]
    for before, after in pairwise(ends):
        if not any(one.blow.kind == "abort" and before.at_s <= one.at_s <= after.at_s for one in seen.struck):
            yield f"it is {before.event.data['state']}, and {after.event.data['state']} again at {after.at_s:.1f} s"


@meanwhile
def _the_slot_clock_keeps_time(seen: Seen) -> Iterator[str]:
    """Let slots pass with the fleet's clock, also over a restart, and stand still in a pause: missions are timed by it.

    A clock of the service that jumps may be taken for time that has passed while it was dead.
    """
    before, seen.slot_clock = seen.slot_clock, _slot_clock(seen)
    after = seen.slot_clock
    if before is None or after is None or before.paused is not after.paused or seen.ground.clock_ahead_s:
        return
    since = takewhile(lambda noted: noted.at_s >= before.at_s, reversed(seen.noted))
    if any(noted.event.kind == "operation" and seen.is_own(noted.event) for noted in since):
        return
    passed_s = 0.0 if after.paused else after.at_s - before.at_s
    if abs(after.elapsed_s - before.elapsed_s - passed_s) > SLOT_CLOCK_S:
        yield f"{after.elapsed_s - before.elapsed_s:.1f} s of slots passed in {passed_s:.1f} s"


def _slot_clock(seen: Seen) -> SlotClock | None:
    operation = seen.operation()
    elapsed_s = None if operation is None else operation.flight.elapsed_s()
    if operation is None or elapsed_s is None:
        return seen.slot_clock
    paused = operation.flight.paused or operation.state is State.PAUSED
    return SlotClock(at_s=seen.ground.now_s, elapsed_s=elapsed_s, paused=paused)


@at_end
def _ends_are_as_they_are_said_to_be(seen: Seen) -> Iterator[str]:
    """Say of each UAV how it ended: who is said to stand on the ground is not searched for.

    One that fell unheard, and is found in a mode in which it may have landed instead, looks as if it had. So does one
    that fell as it restarted, if its clock jumps: that clock alone tells when its motors stopped. An operation that was
    aborted ends with its order, before its UAVs are on the ground.
    """
    if seen.end is None or seen.end.state is State.ABORTED:
        return
    for uav, view in seen.end.uavs.items():
        vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
        clock_lies = seen.harms.get(vehicle.system_id, set()) >= {"reboot", "clock_jump"}
        unheard = (vehicle.system_id in seen.fell_unheard or clock_lies) and vehicle.system_id not in seen.seen_crashed
        if unheard and vehicle.mode not in {Mode.MISSION, Mode.GUIDED}:
            continue
        if view.end is not None and view.end.is_down and (not vehicle.alive or seen.is_aloft(vehicle)):
            yield f"{uav} has {view.end.value}, and is {'up' if vehicle.alive else 'crashed'}"


@at_end
def _event_ids_have_no_gaps(seen: Seen) -> Iterator[str]:
    """Give events numbers without gaps: a client that resumes would wait for the missing one for ever."""
    ids = [event.id for event in seen.events]
    if ids != list(range(1, len(ids) + 1)):
        missing = sorted(set(range(1, ids[-1] + 1)) - set(ids))
        yield f"{len(missing)} of {ids[-1]} are missing, the first is {missing[0] if missing else 'a duplicate'}"


@at_end
def _events_are_announced_once_in_order(seen: Seen) -> Iterator[str]:
    """Announce each event once, in the order of the numbers, also over a restart: clients resume by the last one."""
    ids = [noted.event.id for noted in seen.noted]
    for before, after in pairwise(ids):
        if after <= before:
            yield f"event {after} is announced after event {before}"


@at_end
def _events_are_stored_as_they_were_announced(seen: Seen) -> Iterator[str]:
    """Store each event that was announced, under its number: a number never means two things."""
    stored = {event.id: (event.kind, event.data) for event in seen.events}
    for noted in seen.noted:
        event = noted.event
        if stored.get(event.id) != (event.kind, event.data):
            yield f"event {event.id}, {event.kind}, is stored as {stored.get(event.id, ('nothing',))[0]}"


@at_end
def _nothing_is_denied_by_the_database(seen: Seen) -> Iterator[str]:
    """Write nothing that the database refuses for good, such as a number given twice: it is lost without a word."""
    yield from seen.ground.disk.denied


@at_end
def _steps_outlive_the_service(seen: Seen) -> Iterator[str]:
    """Keep each step that was taken: the next service learns from the journal what may have been sent."""
    stored = Counter((entry.incident, entry.step, entry.uav_id) for entry in seen.journal)
    taken = Counter((one.entry.incident, one.entry.step, one.entry.uav_id) for one in seen.taken)
    for (incident, step, uav), times in taken.items():
        if stored[incident, step, uav] < times:
            yield f"incident {incident}: {step.value} {uav or ''} is not in the journal"


@at_end
def _nothing_is_left_in_the_local_file(seen: Seen) -> Iterator[str]:
    """Clear the local file once the database has what is in it: the next start would store old states again.

    While the disk is full it is where they have to be.
    """
    if seen.held_lines and seen.ground.disk.refuses is None:
        yield f"{seen.held_lines} transactions, though the database took them"


@at_end
def _nothing_fails_unforeseen(seen: Seen) -> Iterator[str]:
    """Foresee every failure: a failed task, or the text of a Python error, is an unforeseen case."""
    for event in seen.events:
        if event.kind == "task_failed":
            yield f"task {event.data['task']}: {event.data['error']}"
        error = event.data.get("error")
        if event.kind in {"operation", "recovery"} and error and _UNFORESEEN.search(str(error)):
            yield f"{event.kind}: {error}"


@at_end
def _no_task_is_left(seen: Seen) -> Iterator[str]:
    """Leave no task behind: what is left of one flight after another fills memory, and may still send."""
    left = seen.ground.alive_tasks
    if left:
        yield f"{len(left)} tasks: {', '.join(left[:5])}"


@at_end
def _no_operation_is_left_in_memory(seen: Seen) -> Iterator[str]:
    """Forget an operation that is over: a service that flies for a year would hold every track of it."""
    if seen.remembered:
        yield f"the service still holds {', '.join(seen.remembered)}"


@afterwards
def _no_file_is_left_open(seen: Seen) -> Iterator[str]:
    """Close every file of its disk: a process may have only so many."""
    before, after = seen.files_open
    if after > before:
        yield f"{after - before} files of its disk more are open than before"
