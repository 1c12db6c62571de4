"""The way of the survivors into a new plan: where they will be, and whether they get there safely."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import copysign, hypot, inf

from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.traffic import Traffic
from skyfolio.mavlink_bridge.altitudes import altitudes_of, lowest_over_ground_m
from skyfolio.mavlink_bridge.corridors import Meeting, meetings
from skyfolio.mavlink_bridge.errors import TransitionTooClose
from skyfolio.mavlink_bridge.ghosts import Airspace, Conflict
from skyfolio.mavlink_bridge.transitions import check_transition
from skyfolio.planner import Plan, ReplanError
from skyfolio.planner.altitudes import clearance_of, climb_mps
from skyfolio.planner.geometry import Point, point_at

SPEED_TOLERANCE = 1.25
"""Share of the maximum speed that a first leg may ask for before it is out of reach: it begins in mid-slot."""
TRACKING_M = 1.0
"""Metres by which a vehicle may be lower than planned: that alone makes no leg too low."""
ROUNDING_M = 0.01
"""Metres of separation that a stored plan may miss by rounding; positions are not known to the centimetre."""


def expected_position(plan: Plan, uav_id: str, live_m: Point, now_s: float, at_slot: int) -> Point:
    """Return where a UAV that follows `plan` will be when slot `at_slot` begins, in metres east/north.

    It flies from where it is now towards the points of the slots between, at most at its maximum speed. live_m: where
    it is now. now_s: fleet seconds since slot 0 of the operation.
    """
    scenario = plan.scenario
    slots_left = max(at_slot - now_s / scenario.slot_duration_s, 0.0)
    first = int(now_s // scenario.slot_duration_s) + 1 - plan.first_slot
    path: Sequence[Point] = plan.trajectories_m[uav_id][max(first, 0) : at_slot - plan.first_slot + 1]
    here = live_m
    for point in path:
        move = point[0] - here[0], point[1] - here[1]
        step, in_a_slot = hypot(*move), scenario.longest_step_m(uav_id, move)
        if step > slots_left * in_a_slot:
            share = slots_left * in_a_slot / step
            return here[0] + share * move[0], here[1] + share * move[1]
        here, slots_left = point, slots_left - (step / in_a_slot if step > 0.0 else 0.0)
    return here


def expected_altitude(plan: Plan, uav_id: str, live_m: float, now_s: float, at_slot: int) -> float:
    """Return how high a UAV that follows `plan` will be when slot `at_slot` begins, in the datum of its altitudes.

    It climbs or descends from where it is now to the altitude that the plan has then, as fast as it can; a metre that
    it is behind by then does not count. live_m: how high it is now. now_s: fleet seconds since slot 0 of the operation.
    """
    scenario = plan.scenario
    left_s = max(at_slot * scenario.slot_duration_s - now_s, 0.0)
    most_m = climb_mps(scenario.uav(uav_id)) * left_s + TRACKING_M
    planned_m = altitudes_of(plan, uav_id).at(at_slot - plan.first_slot)
    short_m = planned_m - live_m
    return planned_m if abs(short_m) <= most_m else live_m + copysign(most_m - TRACKING_M, short_m)


def scheduled_at(plan: Plan, uav_id: str, now_s: float) -> Point:
    """Return where the plan has a UAV `now_s` fleet seconds after slot 0 of the operation began, metres east/north."""
    return point_at(plan.trajectories_m[uav_id], now_s / plan.scenario.slot_duration_s - plan.first_slot)


def begun_at(plan: Plan, uav_id: str, live_m: Point) -> Plan:
    """Return the plan with this UAV's first point where it really is, so that its first leg is timed from there."""
    path = [live_m, *plan.trajectories_m[uav_id][1:]]
    return plan.model_copy(update={"trajectories_m": {**plan.trajectories_m, uav_id: path}})


def way_into(plan: Plan, uav_id: str, live_m: Point, now_s: float, *, first_slot: int, slots: int) -> list[Point]:
    """Return where a UAV that flies from `live_m` into `plan` is when slots begin.

    The result has `slots` points in metres east/north, the first for slot `first_slot` of the operation. The first leg
    is straight and at constant speed, and ends when the slot after the plan's first begins; after the plan's end the
    UAV stays. now_s: fleet seconds since slot 0 of the operation.
    """
    path, slot_s = plan.trajectories_m[uav_id], plan.scenario.slot_duration_s
    joins = min(1, len(path) - 1)
    due_s = (plan.first_slot + joins) * slot_s
    way = []
    for slot in range(first_slot, first_slot + slots):
        at = slot - plan.first_slot
        if at >= joins:
            way.append(path[min(at, len(path) - 1)])
            continue
        share = (slot * slot_s - now_s) / (due_s - now_s)
        (e0, n0), (e1, n1) = live_m, path[joins]
        way.append((e0 + share * (e1 - e0), n0 + share * (n1 - n0)))
    return way


@dataclass(frozen=True)
class Present:
    """The moment from which the missions change: fleet seconds since slot 0, places in metres east/north.

    `plan`: what the missions on board fly. `airspace`: air in which UAVs that were lost may still be. `traffic`: what
    other operations fly. altitudes_m: above mean sea level, as far as they are known.
    """

    now_s: float
    positions_m: Mapping[str, Point]
    plan: Plan
    airspace: Airspace
    traffic: Traffic | None = None
    altitudes_m: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, flight: Flight) -> Present:
        """Return the present of a flight."""
        places = flight.now_s(), flight.positions_m()
        return cls(*places, flight.plan, flight.guidance.airspace, flight.traffic, flight.altitudes_m())

    def require_located(self, uavs: Iterable[str]) -> None:
        """Raise ReplanError naming each of these UAVs that does not know where it is."""
        nowhere = [uav for uav in uavs if uav not in self.positions_m]
        if nowhere:
            raise ReplanError(f"positions_m: {', '.join(nowhere)} does not know where it is")


def require_separated(plans: Mapping[str, Plan], present: Present) -> None:
    """Refuse a change in which UAVs come too close, from where they are now to the end; `plans` has the plan of each.

    Between them `D_min` holds at every moment. A UAV that is lost keeps the air in which it may still be: a UAV that
    crosses it later flies above it (`FlightGuidance.compile`), but on the first leg, on which it climbs, no UAV may
    enter air that the mission now on board stays out of; the same holds for the air of other operations all the rest of
    the way. Raises ReplanError naming who, how close and when.
    """
    present.require_located(plans)
    now_s, live = present.now_s, {uav: present.positions_m[uav] for uav in plans}
    slot_s = present.plan.scenario.slot_duration_s
    first = int(now_s // slot_s) + 1
    slots = max(1, *(plan.first_slot + plan.scenario.slots - first for plan in plans.values()))
    ways = {uav: way_into(plan, uav, live[uav], now_s, first_slot=first, slots=slots) for uav, plan in plans.items()}
    required_m = max(plan.scenario.min_separation_m for plan in plans.values())
    try:
        check_transition(
            live, ways, now_s=now_s, first_due_s=first * slot_s, slot_s=slot_s, required_m=required_m - ROUNDING_M
        )
    except TransitionTooClose as error:
        raise ReplanError(str(error)) from error
    for uav, plan in plans.items():
        _require_clear_of_ghosts(uav, plan, present, required_m)
        require_over_ground(uav, plan, present.positions_m[uav], present.altitudes_m.get(uav), present.now_s)
    if present.traffic is not None:
        _require_clear_of_others(plans, present, present.traffic)


def require_over_ground(uav: str, plan: Plan, live_m: Point, amsl_m: float | None, now_s: float) -> None:
    """Refuse a first leg, from where the UAV is now, that comes too near to the ground; nothing without terrain.

    live_m: metres east/north; amsl_m: its altitude, None if unknown. What it is too low already does not count against
    the leg: the leg must not make it worse. Raises ReplanError naming the UAV and how near it would come.
    """
    scenario, altitudes = plan.scenario, altitudes_of(plan, uav)
    if scenario.terrain is None or amsl_m is None or not altitudes.amsl:
        return
    slot = max(1, int(now_s // scenario.slot_duration_s) + 1 - plan.first_slot)
    path = plan.trajectories_m[uav]
    to_m = path[min(slot, len(path) - 1)]
    lowest_m = min(amsl_m, altitudes.at(slot))
    margin_m = lowest_over_ground_m(scenario, [live_m, to_m], lowest_m)
    here_m = lowest_over_ground_m(scenario, [live_m], amsl_m)
    required_m = clearance_of(scenario) - TRACKING_M
    if margin_m is not None and here_m is not None and margin_m < min(required_m, here_m - TRACKING_M):
        raise ReplanError(
            f"transition: {uav!r} would come within {margin_m:.1f} m of the ground on its first leg; "
            f"{clearance_of(scenario):g} m are asked for"
        )


def _require_clear_of_others(plans: Mapping[str, Plan], present: Present, traffic: Traffic) -> None:
    """Raise ReplanError if a UAV enters air of other operations, at any time, that its plan in force stays out of."""
    others = traffic.others()
    if not others:
        return

    def meets(flown: Mapping[str, Plan]) -> dict[tuple[str, str], Meeting]:
        ours = [
            traffic.corridor(
                uav, [present.positions_m[uav], *_rest_of(plan, uav, present.now_s)], altitudes_of(plan, uav)
            )
            for uav, plan in flown.items()
        ]
        return {
            (meeting.first.uav_id, meeting.second.uav_id): meeting for meeting in meetings(ours, others, ROUNDING_M)
        }

    new = meets(plans)
    flies_on = {uav: present.plan for uav in plans if uav in present.plan.trajectories_m}
    old = meets(flies_on) if new else {}
    for pair, meeting in new.items():
        if pair not in old:
            raise ReplanError(f"transition: {meeting}")


def _rest_of(plan: Plan, uav: str, now_s: float) -> Sequence[Point]:
    path = plan.trajectories_m[uav]
    slot = int(now_s // plan.scenario.slot_duration_s) + 1 - plan.first_slot
    return path[min(max(slot, 1), len(path) - 1) :]


def _require_clear_of_ghosts(uav: str, plan: Plan, present: Present, required_m: float) -> None:
    now_s, live = present.now_s, present.positions_m[uav]
    slot_s = plan.scenario.slot_duration_s
    due = max(plan.first_slot + 1, int(now_s // slot_s) + 1)

    def entered(there: Point) -> dict[tuple[str, str], Conflict]:
        conflicts = present.airspace.conflicts({uav: [live, there]}, [now_s, due * slot_s], required_m)
        return {(conflict.ghost_id, conflict.because): conflict for conflict in conflicts}

    new = entered(way_into(plan, uav, live, now_s, first_slot=due, slots=1)[0])
    flies_on = uav in present.plan.trajectories_m
    old = entered(scheduled_at(present.plan, uav, due * slot_s) if flies_on else live) if new else {}
    for air, conflict in new.items():
        if air not in old:
            raise ReplanError(f"transition: {conflict}")


def require_in_reach(
    plan: Plan, live: Mapping[str, Point], left_s: float, heights_m: Mapping[str, float] | None = None
) -> None:
    """Refuse a plan whose first point a survivor cannot reach in the `left_s` fleet seconds that its first leg has.

    live: where UAVs are, metres east/north. heights_m: how high they are, as far as it is known, in the datum of the
    plan's altitudes. One that is too high comes down later: that is safe. Raises ReplanError naming the UAV.
    """
    for uav in plan.scenario.uavs:
        first = plan.trajectories_m[uav.id][min(1, plan.scenario.slots - 1)]
        short_m = altitudes_of(plan, uav.id).at(1) - (heights_m or {}).get(uav.id, inf)
        if plan.altitudes_m is not None and short_m > climb_mps(uav) * SPEED_TOLERANCE * left_s + TRACKING_M:
            raise ReplanError(f"transition: {uav.id!r} is {short_m:.1f} m too low with {left_s:.1f} s to go")
        here = live[uav.id]
        move = first[0] - here[0], first[1] - here[1]
        far, speed_mps = hypot(*move), plan.scenario.longest_step_m(uav.id, move) / plan.scenario.slot_duration_s
        if far > speed_mps * SPEED_TOLERANCE * left_s + plan.scenario.min_separation_m:
            raise ReplanError(f"transition: {uav.id!r} is {far:.1f} m from its first point with {left_s:.1f} s to go")


def achieved(flight: Flight, previous: Plan, at_slot: int) -> dict[str, list[float]]:
    """Return the bit/s of each user in the slots before `at_slot` that count in a replan of `previous`.

    Slots that are over have the rates as reported; those still to come have the last ones.
    """
    before = max((len(row) for row in previous.achieved_rates_bps.values()), default=0)
    counted, table = before + at_slot - previous.first_slot, {}
    for user, row in flight.reported_rates_bps().items():
        filled: list[float] = []
        for rate in row[: at_slot - flight.rates_from_slot]:
            filled.append(rate if rate is not None else (filled[-1] if filled else 0.0))
        unknown = max(counted - len(filled), 0)
        table[user] = [*filled[:1] * unknown, *filled[max(len(filled) - counted, 0) :]]
    return table
