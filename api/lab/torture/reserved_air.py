"""What must hold of the air in which a lost UAV may still be, judged from where vehicles truly are.

The geometry is this file's own, so that a service whose ghosts are wrong does not judge itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import dist, hypot

from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.api.flights.journal import Step
from skyfolio.api.lab.torture.checks import meanwhile
from skyfolio.api.lab.torture.missions import assigned_mission
from skyfolio.api.lab.torture.sightings import LostUav
from skyfolio.api.lab.torture.vehicles import LOW_M
from skyfolio.api.lab.torture.watch import Seen
from skyfolio.planner.geometry import Point, between
from skyfolio.sim.station import Vehicle

OFF_LINE_M = 1.0
"""How far off its straight legs a vehicle may be."""
OFF_SCHEDULE_M = 2.5
"""How much nearer two vehicles may come because neither is where its schedule has it."""
RAISED_M = 4.0
"""A mission that is this much higher than the plan crosses reserved air above it."""
STEPS = 20
"""Points of each leg that are looked at."""
SETTLES_S = 3.0
"""Seconds after its first leg in which a vehicle may still climb."""


@meanwhile
def _separation_from_reserved_air(seen: Seen) -> Iterator[str]:
    """Keep out of the air of a UAV that is lost, or fly above it: it may still be there, and is not commanded."""
    operation = seen.operation()
    elapsed_s = None if operation is None else operation.flight.elapsed_s()
    if operation is None or elapsed_s is None or seen.state != "flying":
        return
    for uav in [uav for uav in seen.lost if uav not in operation.flight.lost]:
        del seen.lost[uav]  # it was readmitted
    for lost in seen.lost.values():
        for vehicle in seen.ground.fleet.vehicles.values():
            if _is_to_stay_out(seen, vehicle, lost, elapsed_s):
                yield from _too_close(seen, vehicle, lost)


def _is_to_stay_out(seen: Seen, vehicle: Vehicle, lost: LostUav, elapsed_s: float) -> bool:
    """Return whether a vehicle flies a mission, at the height of its plan, that was made after the loss.

    One that somebody or something else flies is not ours to keep out. A mission from before the loss keeps apart from
    where the lost one has to be at the same time, which may be near its way home, until the next one is flown. On its
    first leg a vehicle comes from where that one has led it, and it may climb on it. After the last slot it lands below
    where it is.
    """
    system_id = vehicle.system_id
    if system_id == lost.system_id or system_id in seen.harmed or system_id in seen.ordered:
        return False
    if not seen.follows_a_plan(vehicle) or not seen.is_aloft(vehicle):
        return False
    sent = seen.last_taken(Step.UPLOADING, seen.uav_of(system_id))
    began_s = None if sent is None else seen.incident(sent.entry.incident, Step.DETECTED)
    if began_s is None or began_s < lost.lost_at_s:
        return False
    assigned = assigned_mission(seen, vehicle)
    if assigned is None or _is_raised(seen, assigned):
        return False
    first_leg_ends_s = (assigned.first_slot + 1) * assigned.slot_s
    last_slot_s = (seen.drill.slots - 1) * assigned.slot_s
    return first_leg_ends_s + SETTLES_S < elapsed_s < last_slot_s


def _too_close(seen: Seen, vehicle: Vehicle, lost: LostUav) -> Iterator[str]:
    at_m = seen.place_m(vehicle)
    required_m = seen.ground.scenario.min_separation_m
    apart_m = min((_to_line_m(at_m[:2], *way) for way in _ways(seen, lost)), default=required_m)
    if apart_m < required_m - OFF_LINE_M:
        yield f"vehicle {vehicle.system_id} is {apart_m:.1f} m from where {lost.uav} was, or may fly to land"
    ghost = seen.ground.fleet.vehicles[lost.system_id]
    ghost_m = seen.place_m(ghost)
    if seen.is_aloft(ghost) and dist(at_m, ghost_m) < required_m - OFF_SCHEDULE_M:
        yield f"vehicle {vehicle.system_id} is {dist(at_m, ghost_m):.1f} m from {lost.uav}, which was lost"


@meanwhile
def _missions_keep_out_of_reserved_air(seen: Seen) -> Iterator[str]:
    """Send no mission through the air of a UAV that was lost before, unless it is flown above that."""
    for one in seen.new_reports:
        began_s = seen.incident(one.report.incident, Step.DETECTED)
        flying = [uav for uav, error in one.report.vehicles.items() if error is None]
        for uav in flying if began_s is not None else ():
            assigned = assigned_mission(seen, seen.ground.fleet.vehicles[seen.system_of(uav)])
            if assigned is None or assigned.first_slot != one.report.at_slot or _is_raised(seen, assigned):
                continue
            for lost in seen.lost.values():
                if lost.uav != uav and lost.lost_at_s <= (began_s or 0.0):
                    yield from _crosses(seen, uav, assigned.path_m, lost)


def _ways(seen: Seen, lost: LostUav) -> list[tuple[Point, Point]]:
    """Return the lines to where a UAV that is not heard may land: from where it was, and from the end of its mission.

    It lands at home or at a rally point. One that is heard again flies where it is seen, which is looked at itself.
    """
    if lost.stood_m is None:
        return []
    scenario = seen.ground.scenario
    starts_m = [lost.stood_m] if lost.end_m is None else [lost.stood_m, lost.end_m]
    ends_m = (scenario.uav(lost.uav).start_m, *scenario.rally_m)
    return [(start_m, end_m) for start_m in starts_m for end_m in ends_m]


def _is_raised(seen: Seen, assigned: AssignedMission) -> bool:
    return assigned.altitude_m >= seen.drill.altitude_m + RAISED_M


def _crosses(seen: Seen, uav: str, path_m: Sequence[Point], lost: LostUav) -> Iterator[str]:
    required_m = seen.ground.scenario.min_separation_m
    points_m = [between(start, end, step / STEPS) for start, end in pairwise(path_m) for step in range(STEPS + 1)]
    near_m = (_to_line_m(point_m, *way) for way in _ways(seen, lost) for point_m in points_m)
    apart_m = min(near_m, default=required_m)
    if apart_m < required_m - 2 * OFF_LINE_M:
        yield f"that of {uav} comes within {apart_m:.1f} m of where {lost.uav} was, or may fly to land"


@meanwhile
def _air_is_freed_when_nobody_is_in_it(seen: Seen) -> Iterator[str]:
    """Free reserved air when the UAV is seen on the ground, not before: others are sent there next."""
    for noted in seen.news:
        if noted.event.kind == "ghost_released":
            uav = noted.event.data["uav_id"]
            vehicle = seen.ground.fleet.vehicles[seen.system_of(uav)]
            if vehicle.alive and vehicle.armed and vehicle.position[2] > 2 * LOW_M:
                yield f"that of {uav}, which is {vehicle.position[2]:.0f} m up"
            seen.lost.pop(uav, None)


@meanwhile
def _air_is_reserved_for_who_is_lost(seen: Seen) -> Iterator[str]:
    """Reserve no air for a UAV that counts: others would fly around it for nothing."""
    operation = seen.operation()
    if operation is not None:
        for uav in operation.flight.guidance.airspace.ghosts.keys() - operation.flight.lost.keys():
            yield f"that of {uav}, which is not lost"


@meanwhile
def _the_air_of_who_is_lost_is_reserved(seen: Seen) -> Iterator[str]:
    """Reserve the air of a UAV that is lost and may still fly, until it is seen on the ground, also over a restart."""
    operation = seen.operation()
    if operation is None or operation.flight.elapsed_s() is None:
        return
    for uav in seen.lost.keys() & operation.flight.lost.keys() - operation.flight.guidance.airspace.ghosts.keys():
        loss = operation.flight.roster.losses.get(uav)
        if loss is None or loss.in_the_air:
            yield f"that of {uav} is not"


def _to_line_m(point_m: Point, from_m: Point, to_m: Point) -> float:
    """Return the metres from a point to the nearest of a straight line."""
    east, north = to_m[0] - from_m[0], to_m[1] - from_m[1]
    length2 = east**2 + north**2
    along = (point_m[0] - from_m[0]) * east + (point_m[1] - from_m[1]) * north
    share = min(max(along / length2, 0.0), 1.0) if length2 else 0.0
    return hypot(point_m[0] - from_m[0] - share * east, point_m[1] - from_m[1] - share * north)
