"""What must hold in every drill: of the vehicles, of the records, and of the air that is reserved.

Here are those of the vehicles, as they really fly. Each is a function with its reason, and yields what is broken.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import dist

from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.torture import guiding, losses, records, recoveries, reserved_air, stations
from skyfolio.api.lab.torture.checks import AFTERWARDS, AT_END, MEANWHILE, at_end, look, meanwhile
from skyfolio.api.lab.torture.guiding import AFTER
from skyfolio.api.lab.torture.missions import has_a_strange_mission, is_strange
from skyfolio.api.lab.torture.vehicles import LOW_M
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.sim import Mode
from skyfolio.sim.station import Vehicle

__all__ = [
    "AFTERWARDS",
    "AT_END",
    "MEANWHILE",
    "guiding",
    "look",
    "losses",
    "records",
    "recoveries",
    "reserved_air",
    "stations",
]
READ_BACK_S = 10.0
"""A vehicle that has stored wrongly what it was sent may fly that for so long: by then it is read back, or it holds."""
OFF_PLAN_M = 2.5
"""How much nearer than D_min two vehicles may come by being off their places, each by half of it."""
NOTICED_S = 6.0
"""A vehicle that a human or a failsafe flies may be commanded for so long: heartbeats come at 1 Hz, and get lost."""
COMMANDS = frozenset({"COMMAND_INT", "MISSION_COUNT", "MISSION_SET_CURRENT", "SET_POSITION_TARGET_GLOBAL_INT"})
HARMLESS = frozenset({178, 511, 512, 521})
"""Commands that change no way: an own speed given back, and questions."""


@meanwhile
def _separation(seen: Seen) -> Iterator[str]:
    """Keep vehicles D_min apart that fly plans, of any operation: every plan and every change was checked for that."""
    required_m = seen.ground.scenario.min_separation_m - OFF_PLAN_M
    flying = [vehicle for vehicle in seen.ground.fleet.vehicles.values() if _flies_a_plan(seen, vehicle)]
    frames = {vehicle.system_id: seen.place_m(vehicle) for vehicle in flying}
    for one, other in combinations(flying, 2):
        apart_m = dist(frames[one.system_id], frames[other.system_id])
        if apart_m < required_m:
            yield f"vehicles {one.system_id} and {other.system_id} are {apart_m:.1f} m apart"


def _flies_a_plan(seen: Seen, vehicle: Vehicle) -> bool:
    """Return whether a vehicle flies what was planned for it.

    A blow to it, a human or a failsafe may lead it anywhere. Near the ground it takes off or lands, as others do.
    """
    system_id = vehicle.system_id
    untouched = system_id not in seen.harmed and system_id not in seen.foreign
    return untouched and vehicle.armed and seen.follows_a_plan(vehicle) and vehicle.position[2] > LOW_M


@meanwhile
def _whole_missions(seen: Seen) -> Iterator[str]:
    """Fly whole missions, old or new, never a mixture: people have lost aircraft to hybrids.

    A vehicle that stores wrongly what it is sent flies that until it is read back.
    """
    for vehicle in seen.ground.fleet.vehicles.values():
        flies = vehicle.mode is Mode.MISSION and vehicle.armed and vehicle.alive
        if not flies or not has_a_strange_mission(seen, vehicle):
            seen.strange_since_s.pop(vehicle.system_id, None)
            continue
        since_s = seen.strange_since_s.setdefault(vehicle.system_id, seen.ground.now_s)
        wrongly = "corrupt_upload" in seen.harms.get(vehicle.system_id, ())
        if not wrongly or seen.ground.now_s - since_s > READ_BACK_S:
            yield f"vehicle {vehicle.system_id} flies {len(vehicle.mission.items)} items that no assigned mission has"


@meanwhile
def _nobody_begins_a_mission_that_is_not_proven(seen: Seen) -> Iterator[str]:
    """Let a vehicle hover, after an upload that failed, until it is known what it has: it would fly that at once.

    A vehicle that never stopped flies what it has stored wrongly until that is read back.
    """
    begun, seen.begun[:] = list(seen.begun), []
    for at_s, system_id, stored in begun:
        if seen.uav_of(system_id) in seen.uavs and is_strange(seen, seen.ground.fleet.vehicles[system_id], stored):
            yield f"vehicle {system_id} began at {at_s:.1f} s to fly items that no assigned mission has"


@meanwhile
def _nobody_commands_a_vehicle_that_a_human_or_a_failsafe_flies(seen: Seen) -> Iterator[str]:
    """Leave a vehicle alone that others fly: the autopilot's failsafe comes first, then the human, then we.

    An operator who orders it later knows of that. A question, or its own speed given back, changes no way.
    """
    for at_s, system_id, message in seen.received:
        since_s = seen.foreign.get(system_id)
        if since_s is None or at_s < since_s + NOTICED_S or seen.ordered.get(system_id, -1.0) > since_s:
            continue
        name = message.get_type()
        if name in COMMANDS or (name == "COMMAND_LONG" and message.command not in HARMLESS):
            number = getattr(message, "command", "")
            yield f"vehicle {system_id} got {name} {number} {at_s - since_s:.1f} s after it was taken over"


@at_end
def _nobody_healthy_crashes(seen: Seen) -> Iterator[str]:
    """Bring intact vehicles down softly, whatever happens to the others; one that a blow has hit may fall by itself."""
    for event in seen.ground.fleet.truth.happened("crashed"):
        if event.system_id not in seen.harmed:
            yield f"vehicle {event.system_id} crashed at {event.t_s:.1f} s"


@at_end
def _who_flew_to_the_end_is_on_the_ground(seen: Seen) -> Iterator[str]:
    """Leave no vehicle of a completed operation in the air, but those that a blow or the operator keeps there."""
    if seen.end is None or seen.end.state not in {State.COMPLETED, State.COMPLETED_PARTLY}:
        return
    for vehicle in seen.vehicles():
        left_to_it = vehicle.system_id not in seen.harmed and vehicle.system_id not in seen.ordered
        if left_to_it and vehicle.armed and vehicle.position[2] > LOW_M:
            yield f"vehicle {vehicle.system_id} is {vehicle.position[2]:.0f} m up"


@at_end
def _nothing_fails_to_which_nothing_happened(seen: Seen) -> Iterator[str]:
    """Fly an operation that was not struck, on a link that loses at most a tenth; who holds at the end may stay up."""
    end = seen.end
    if end is None or end.state is not State.FAILED or seen.struck or seen.drill.loss > 0.1:
        return
    if seen.drill.at_end != "hold" or not (end.error or "").startswith("landing"):
        yield f"it failed: {end.error}"


@at_end
def _vehicles_are_left_as_they_were_ordered(seen: Seen) -> Iterator[str]:
    """Leave vehicles to the order that ended their operation: what is sent after it would undo it.

    What the operator orders a vehicle to do apart from that may come later, and is flown then.
    """
    end = seen.end
    if end is None:
        return
    if end.state is State.FAILED:
        ordered = dict.fromkeys((uav for uav in end.vehicles if uav not in end.lost), _NO_MISSION)
    elif end.abort is not None:
        ordered = dict.fromkeys(
            (uav for uav, error in end.abort.vehicles.items() if error is None), AFTER[end.abort.action]
        )
    else:
        return
    orders = [one.blow.options.get("uavs") or seen.uavs for one in seen.struck if one.blow.kind == "order"]
    apart = {uav for uavs in orders for uav in uavs}
    for uav, modes in ordered.items():
        if uav in apart:
            continue
        vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
        if vehicle.system_id not in seen.harmed and seen.is_aloft(vehicle) and vehicle.mode not in modes:
            yield f"{uav} is in mode {vehicle.mode.name} after the operation has {end.state.value}"


_NO_MISSION = frozenset(Mode) - {Mode.MISSION}
