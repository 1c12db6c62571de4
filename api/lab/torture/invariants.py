"""What must hold in every drill, each a function with its reason.

`meanwhile`: looked at every half second of fleet time. `at_end`: looked at when the operation is over and the service
has stopped. Each returns what is broken, None or nothing if it holds.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import combinations
from math import dist

from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import ENDED, State
from skyfolio.api.lab.torture.missions import on_board_of, strangers
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.sim import Mode
from skyfolio.sim.station import Vehicle

Check = Callable[[Seen], Iterator[str]]
MEANWHILE: dict[str, Check] = {}
AT_END: dict[str, Check] = {}
OFF_PLAN_M = 2.5
"""How much nearer than D_min two vehicles may come by being off their places, each by half of it."""
LOW_M = 2.0
NOTICED_S = 6.0
"""A vehicle that a human or a failsafe flies may be commanded for so long: heartbeats come at 1 Hz, and get lost."""
RECOVERED_S = 45.0
"""An incident may be open for so long while vehicles are heard and no operator is asked."""
COMMANDS = frozenset({"COMMAND_INT", "MISSION_COUNT", "MISSION_SET_CURRENT", "SET_POSITION_TARGET_GLOBAL_INT"})
HARMLESS = frozenset({178, 511, 512, 521})
"""Commands that change no way: an own speed given back, and questions."""
_UNFORESEEN = re.compile(r"\b(?!TimeoutError)\w+(Error|Exception): ")


def meanwhile(check: Check) -> Check:
    """Add an invariant that must hold all the time."""
    MEANWHILE[check.__name__.removeprefix("_").replace("_", " ")] = check
    return check


def at_end(check: Check) -> Check:
    """Add an invariant that must hold when all is over."""
    AT_END[check.__name__.removeprefix("_").replace("_", " ")] = check
    return check


@meanwhile
def _separation(seen: Seen) -> Iterator[str]:
    """Keep vehicles that fly missions D_min apart: that is what every plan and every change was checked for."""
    required_m = seen.ground.scenario.min_separation_m - OFF_PLAN_M
    flying = [vehicle for vehicle in seen.ground.fleet.vehicles.values() if _flies_a_plan(seen, vehicle)]
    frames = {vehicle.system_id: seen.place_m(vehicle) for vehicle in flying}
    for one, other in combinations(flying, 2):
        apart_m = dist(frames[one.system_id], frames[other.system_id])
        if apart_m < required_m:
            yield f"vehicles {one.system_id} and {other.system_id} are {apart_m:.1f} m apart"


def _flies_a_plan(seen: Seen, vehicle: Vehicle) -> bool:
    system_id = vehicle.system_id
    untouched = system_id not in seen.harmed and system_id not in seen.foreign
    return untouched and vehicle.armed and vehicle.mode is Mode.MISSION and vehicle.position[2] > LOW_M


@meanwhile
def _whole_missions(seen: Seen) -> Iterator[str]:
    """Fly whole missions, old or new, never a mixture: people have lost aircraft to hybrids."""
    for vehicle in seen.ground.fleet.vehicles.values():
        if vehicle.mode is Mode.MISSION and vehicle.armed and vehicle.alive:
            items = on_board_of(vehicle)
            if items and strangers(seen, vehicle, items):
                yield f"vehicle {vehicle.system_id} flies {len(items)} items that no assigned mission has"


@meanwhile
def _nobody_commands_a_vehicle_that_a_human_or_a_failsafe_flies(seen: Seen) -> Iterator[str]:
    """Leave a vehicle alone that others fly: the autopilot's failsafe comes first, then the human, then we."""
    received, seen.received = seen.received, []
    for at_s, system_id, message in received:
        since_s = seen.foreign.get(system_id)
        if since_s is None or at_s < since_s + NOTICED_S or seen.ordered.get(system_id, -1.0) > since_s:
            continue
        name = message.get_type()
        if name in COMMANDS or (name == "COMMAND_LONG" and message.command not in HARMLESS):
            number = getattr(message, "command", "")
            yield f"vehicle {system_id} got {name} {number} {at_s - since_s:.1f} s after it was taken over"


@at_end
def _every_operation_ends(seen: Seen) -> Iterator[str]:
    """End every operation: one that never ends keeps its vehicles, and its operator, for ever."""
    if seen.end is None or seen.end.state not in ENDED:
        state = "unknown" if seen.end is None else seen.end.state.value
        yield f"it is {state} {seen.ground.now_s:.0f} s after the start"


@at_end
def _every_incident_is_closed_once(seen: Seen) -> Iterator[str]:
    """Close every incident once: an open one is not dealt with, and a second end contradicts the first."""
    closed = Counter(entry.incident for entry in seen.journal if entry.step is Step.CLOSED)
    for incident in sorted({entry.incident for entry in seen.journal}):
        if closed[incident] != 1:
            yield f"incident {incident} is closed {closed[incident]} times"


@at_end
def _survivors_are_on_a_plan_soon_after_a_verdict(seen: Seen) -> Iterator[str]:
    """Deal with a loss soon: the users of a lost UAV have nothing until the others fly a new plan."""
    if seen.drill.policy != "auto" or any(blow.blow.kind in _DELAYING for blow in seen.struck):
        return
    began: dict[int, float] = {}
    for entry in seen.journal:
        at_s = entry.at.timestamp()
        began.setdefault(entry.incident, at_s)
        if entry.step is Step.CLOSED and at_s - began[entry.incident] > RECOVERED_S:
            yield f"incident {entry.incident} took {at_s - began[entry.incident]:.0f} s"


_DELAYING = frozenset({"kill_service", "clock_jump", "dead_workers", "mute", "impair", "gps_loss", "freeze", "pause"})


@at_end
def _event_ids_have_no_gaps(seen: Seen) -> Iterator[str]:
    """Give events numbers without gaps: a client that resumes would wait for the missing one for ever."""
    ids = [event.id for event in seen.events]
    if ids != list(range(1, len(ids) + 1)):
        missing = sorted(set(range(1, ids[-1] + 1)) - set(ids))
        yield f"{len(missing)} of {ids[-1]} are missing, the first is {missing[0] if missing else 'a duplicate'}"


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
def _nobody_healthy_is_lost(seen: Seen) -> Iterator[str]:
    """Lose no vehicle on a link that loses a tenth: a false loss takes a good UAV from its users."""
    if seen.drill.loss > 0.1:
        return
    ids = seen.ground.scenario.uav_ids
    for event in seen.events:
        if event.kind == "uav_lost" and event.data["cause"] == "heartbeat_lost":
            uav = event.data["uav_id"]
            if ids.index(uav) + 1 not in seen.harmed:
                yield f"{uav} was declared lost ({event.data['detail']}) and nothing had happened to it"


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
def _nobody_healthy_crashes(seen: Seen) -> Iterator[str]:
    """Bring intact vehicles down softly, whatever happens to the others."""
    for event in seen.ground.fleet.truth.happened("crashed"):
        if event.system_id not in seen.harmed:
            yield f"vehicle {event.system_id} crashed at {event.t_s:.1f} s"


@at_end
def _who_flew_to_the_end_is_on_the_ground(seen: Seen) -> Iterator[str]:
    """Leave no vehicle of a completed operation in the air."""
    if seen.end is None or seen.end.state not in {State.COMPLETED, State.COMPLETED_PARTLY}:
        return
    for vehicle in seen.ground.fleet.vehicles.values():
        left_to_it = vehicle.system_id not in seen.harmed and vehicle.system_id not in seen.ordered
        if left_to_it and vehicle.armed and vehicle.position[2] > LOW_M:
            yield f"vehicle {vehicle.system_id} is {vehicle.position[2]:.0f} m up"


@at_end
def _no_task_is_left(seen: Seen) -> Iterator[str]:
    """Leave no task behind: what is left of one flight after another fills memory, and may still send."""
    left = seen.ground.alive_tasks
    if left:
        yield f"{len(left)} tasks: {', '.join(left[:5])}"


def look(seen: Seen, checks: dict[str, Check]) -> None:
    """Note which of these invariants are broken now."""
    for name, check in checks.items():
        for detail in check(seen):
            seen.break_once(name, detail)
