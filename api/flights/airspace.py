"""The air of all operations of one service: no UAV is sent where a UAV of another operation may be.

Before a take-off whole sweeps are compared (`mavlink_bridge.corridors`), in flight every change of plan. UAVs that one
operation has lost are ghosts to all operations, also after it is over, until they are seen on the ground.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.mavlink_bridge import OnEnd, east_north_to_geodetic, geodetic_to_east_north
from skyfolio.mavlink_bridge.altitudes import Altitudes, altitudes_of
from skyfolio.mavlink_bridge.corridors import Corridor, Mapped, meetings
from skyfolio.mavlink_bridge.ghosts import Ghost
from skyfolio.mavlink_bridge.ghosts import Way as GhostWay
from skyfolio.mavlink_bridge.route import Route
from skyfolio.planner import Origin, Plan
from skyfolio.planner.geometry import Point

NO_OPERATION = "no operation"
ROUNDING_M = 0.01
"""Metres of separation that stored plans may miss by rounding."""


@dataclass(frozen=True)
class LeftBehind:
    """A ghost of an operation that is over.

    Its times are fleet seconds; its places are metres east/north of `origin`. required_m: the separation that is kept
    from it.
    """

    ghost: Ghost
    origin: Origin
    required_m: float


class FlightTraffic:
    """The other aircraft as one flight sees them, and its own air; metres east/north of its scenario's origin."""

    def __init__(self, airspace: SharedAirspace, operation_id: str, flight: Flight, fleet: Fleet) -> None:
        self._airspace, self._id, self._flight, self._fleet = airspace, operation_id, flight, fleet
        self.owner = f"operation '{operation_id}'"

    def others(self) -> list[Corridor]:
        """Return the corridors of UAVs that fly for other operations, or for none, and are heard."""
        return self._airspace.others(self._flight.first_plan.scenario.origin, self._id, ghosts=False)

    def corridor(
        self, uav: str, level_m: Sequence[Point], altitudes: Altitudes | None, *, climbs: bool = False
    ) -> Corridor:
        """Return the air of a UAV of this flight that flies this line and then descends.

        level_m: metres east/north. altitudes: None if it descends from where it is. climbs: it climbs
        at the first point of the line.
        """
        flight = self._flight
        down = _ways_down(level_m[-1], flight.landing_m(uav), flight.guidance.options.at_end)
        return Corridor(
            uav_id=uav,
            owner=self.owner,
            required_m=flight.first_plan.scenario.min_separation_m,
            level_m=() if altitudes is None else level_m,
            **_span(self._fleet, flight.systems[uav], altitudes),
            upright_m=((level_m[0],), *down) if climbs else down,
        )


class SharedAirspace:
    """The air of every flight, from when its operation begins (`enter`) until it is over (`leave`)."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._flights: dict[str, Flight] = {}
        self._traffic: dict[str, FlightTraffic] = {}
        self._left: dict[str, LeftBehind] = {}

    def enter(self, operation_id: str, flight: Flight) -> None:
        """Reserve the air of a flight from now on, and let the flight know that of the others."""
        self._flights[operation_id] = flight
        for uav in flight.systems:
            self._left.pop(uav, None)
        self._traffic[operation_id] = flight.traffic = FlightTraffic(self, operation_id, flight, self._fleet)
        flight.guidance.airspace.elsewhere = lambda: self._ghosts_for(operation_id)

    def leave(self, operation_id: str) -> None:
        """Release the air of a flight that is over, except for that of the UAVs that it has lost."""
        self._traffic.pop(operation_id, None)
        flight = self._flights.pop(operation_id, None)
        if flight is None:
            return
        shift_s = self._fleet.now_s() - flight.now_s()
        scenario = flight.first_plan.scenario
        for uav, ghost in flight.guidance.airspace.ghosts.items():
            self._left[uav] = LeftBehind(
                _moved(ghost, shift_s, lambda point: point), scenario.origin, scenario.min_separation_m
            )

    async def require_clear(self, plan: Plan, systems: dict[str, int], options: GuidanceOptions) -> None:
        """Raise ConflictError if a UAV of this plan could meet one of another operation, or one that flies for none."""
        ours = [
            Corridor(
                uav_id=uav,
                owner="this plan",
                required_m=plan.scenario.min_separation_m,
                level_m=path,
                **_span(self._fleet, systems[uav], altitudes_of(plan, uav)),
                upright_m=((path[0],), *_ways_down(path[-1], (path[0], *plan.scenario.rally_m), options.at_end)),
            )
            for uav, path in plan.trajectories_m.items()
        ]
        others = [corridor for corridor in self.others(plan.scenario.origin) if corridor.uav_id not in systems]
        too_close = await asyncio.to_thread(meetings, ours, others, ROUNDING_M)
        if too_close:
            more = f", and {len(too_close) - 1} more" if len(too_close) > 1 else ""
            raise ConflictError(f"separation: {too_close[0]}{more}")

    # -- who is there -----------------------------------------------------------------------------------------------

    def others(self, origin: Origin, except_id: str | None = None, *, ghosts: bool = True) -> list[Corridor]:
        """Return the corridors of all operations, and of UAVs that fly for none; metres east/north of `origin`.

        except_id: the operation that is left out. ghosts: whether UAVs that were lost, and may still fly, are included.
        """
        corridors = [
            corridor
            for operation_id, flight in self._flights.items()
            if operation_id != except_id
            for corridor in self._of_flight(operation_id, flight, origin, ghosts=ghosts)
        ]
        if ghosts:
            now_s = self._fleet.now_s()
            corridors += [
                _of_ghost(left.ghost, NO_OPERATION, left.required_m, now_s).mapped(_between(left.origin, origin))
                for left in self._still_left().values()
            ]
        flown = {uav for flight in self._flights.values() for uav in flight.systems}
        strays = [uav for uav in self._fleet.uav_ids if uav not in flown]
        return corridors + [corridor for uav in strays for corridor in self._of_stray(uav, origin)]

    def _of_flight(self, operation_id: str, flight: Flight, origin: Origin, *, ghosts: bool) -> Iterator[Corridor]:
        traffic, mapped = self._traffic[operation_id], _between(flight.first_plan.scenario.origin, origin)
        live, begun = flight.positions_m(), flight.elapsed_s() is not None
        for uav, system in flight.systems.items():
            ghost, here = flight.guidance.airspace.ghosts.get(uav), live.get(uav)
            if ghost is not None:
                if ghosts:
                    scenario = flight.first_plan.scenario
                    yield _of_ghost(ghost, traffic.owner, scenario.min_separation_m, flight.now_s()).mapped(mapped)
                continue
            if begun and self._fleet.is_down(system):
                continue
            routes = [] if uav in flight.lost else list(_remaining(flight, uav))
            if not routes and here is not None:
                yield traffic.corridor(uav, [here], None).mapped(mapped)
            for path, altitudes in routes:
                level_m = [here, *path] if begun and here is not None else path
                yield traffic.corridor(uav, level_m, altitudes, climbs=not begun).mapped(mapped)

    def _of_stray(self, uav: str, origin: Origin) -> Iterator[Corridor]:
        """Yield the corridor of a UAV that flies for no operation: where it is, and its way home, at any height."""
        system = self._fleet.system_of(uav)
        telemetry = self._fleet.link.telemetry(system)
        if telemetry is None or telemetry.place_deg is None:
            return
        if not self._fleet.is_heard(system) or self._fleet.is_down(system):
            return
        at_m = geodetic_to_east_north(origin, *telemetry.place_deg)
        home = self._fleet.link.home_deg(system)
        ways = [(at_m,)] if home is None else [(at_m, geodetic_to_east_north(origin, *home))]
        yield Corridor(uav_id=uav, owner=NO_OPERATION, required_m=0.0, upright_m=tuple(ways))

    # -- ghosts -----------------------------------------------------------------------------------------------------

    def _ghosts_for(self, operation_id: str) -> list[Ghost]:
        """Return the ghosts of other operations, in the time and place of this one."""
        own_flight = self._flights[operation_id]
        origin, now_s = own_flight.first_plan.scenario.origin, own_flight.now_s()
        ghosts = [
            _moved(ghost, now_s - flight.now_s(), _between(flight.first_plan.scenario.origin, origin))
            for other, flight in self._flights.items()
            if other != operation_id
            for ghost in flight.guidance.airspace.ghosts.values()
        ]
        shift_s = now_s - self._fleet.now_s()
        return ghosts + [
            _moved(left.ghost, shift_s, _between(left.origin, origin)) for left in self._still_left().values()
        ]

    def _still_left(self) -> dict[str, LeftBehind]:
        """Return the ghosts of operations that are over, except for those that are, or must be, on the ground."""
        now_s, known = self._fleet.now_s(), set(self._fleet.uav_ids)
        for uav, left in list(self._left.items()):
            system = self._fleet.system_of(uav) if uav in known else None
            is_down = system is not None and self._fleet.is_heard(system) and self._fleet.is_down(system)
            if is_down or now_s >= left.ghost.deadline_s:
                del self._left[uav]
        return self._left


def _span(fleet: Fleet, system: int, altitudes: Altitudes | None) -> dict[str, float | None]:
    """Return between which heights above sea level a corridor is flown; None as long as these are not known."""
    if altitudes is None:
        return {"height_m": None}
    if altitudes.amsl:
        return {"height_m": altitudes.lowest_m, "top_m": altitudes.highest_m}
    lowest_m = fleet.height_amsl_m(system, altitudes.lowest_m)
    top_m = fleet.height_amsl_m(system, altitudes.highest_m)
    return {"height_m": lowest_m, "top_m": top_m}


def _remaining(flight: Flight, uav: str) -> Iterator[tuple[list[Point], Altitudes]]:
    """Yield path and altitudes of each route that a UAV may still fly: the plan's, and those on board."""
    plan, now_s = flight.plan, flight.now_s()
    if uav in plan.trajectories_m:
        slot_s = plan.scenario.slot_duration_s
        path = _rest(plan.trajectories_m[uav], plan.first_slot * slot_s, slot_s, now_s)
        yield path, altitudes_of(plan, uav)
    for assigned in flight.guidance.may_fly(uav):
        yield _rest(assigned.path_m, assigned.began_s, assigned.slot_s, now_s), assigned.altitudes


def _rest(path: Sequence[Point], began_s: float, slot_s: float, now_s: float) -> list[Point]:
    return list(path[min(max(int((now_s - began_s) // slot_s), 0), len(path) - 1) :])


def _ways_down(last_m: Point, landing_m: Sequence[Point], at_end: OnEnd) -> tuple[Sequence[Point], ...]:
    """Return the lines above which a UAV may descend after its last point."""
    return tuple((last_m, place_m) for place_m in landing_m) if at_end is OnEnd.RETURN else ((last_m,),)


def _of_ghost(ghost: Ghost, owner: str, required_m: float, now_s: float) -> Corridor:
    """Return the corridor of a ghost, at any height: the rest of each route, where it was seen, and its ways home."""
    rests = [_rest(way.route.path_m, way.began_s, way.route.slot_s, now_s) for way in ghost.ways]
    lines = (*rests, *ghost.ways_home, (ghost.last_seen_m,))
    return Corridor(uav_id=ghost.uav_id, owner=owner, required_m=required_m, upright_m=lines)


def _moved(ghost: Ghost, shift_s: float, mapped: Mapped) -> Ghost:
    """Return the ghost by a clock that shows `shift_s` more, with places as `mapped` converts them."""
    return replace(
        ghost,
        lost_at_s=ghost.lost_at_s + shift_s,
        deadline_s=ghost.deadline_s + shift_s,
        last_seen_m=mapped(ghost.last_seen_m),
        home_m=None if ghost.home_m is None else mapped(ghost.home_m),
        rally_m=tuple(mapped(point) for point in ghost.rally_m),
        ways=tuple(
            GhostWay(
                route=Route([mapped(point) for point in way.route.path_m], way.route.slot_s),
                began_s=way.began_s + shift_s,
            )
            for way in ghost.ways
        ),
    )


def _between(origin: Origin, other: Origin) -> Mapped:
    """Return what converts metres east/north of one origin to those of another."""
    if origin == other:
        return lambda point: point
    return lambda point: geodetic_to_east_north(other, *east_north_to_geodetic(origin, *point))
