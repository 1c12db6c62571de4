"""An independent check that a plan satisfies the constraints of problem (6).

It reads the emitted plan (ids and numbers), shares no code with the optimisers, and tolerates nothing in (6a)-(6g)
beyond the rounding of one floating-point subtraction.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations, pairwise
from math import hypot, isfinite

from shapely import LineString, Polygon
from shapely import Point as GeoPoint

from skyfolio.planner.clearance import breaches
from skyfolio.planner.feasibility_air import air_faults
from skyfolio.planner.geometry import distance_to_segment_m
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Frozen, NoFlyDisc, NoFlyPolygon, Uav

ROUNDING_M = 1e-9
ROUNDING_HZ = 1e-6
BAND_ROUNDING = 1e-14
"""Relative: what adding up the shares of a very wide band is off by."""
MIN_RATE_ROUNDING = 1e-9
"""Relative: a rate this little below `min_rate_bps` is that rate."""


DEMAND_ROUNDING = 1e-7
"""Relative: a rate this little above `demand_bps` is that rate; minimum rates are kept a little above what is asked."""


class Violation(Frozen):
    """One broken constraint: its number in the letter, where, and by how much."""

    constraint: str
    where: str
    message: str


class InfeasiblePlanError(RuntimeError):
    """A plan breaks a constraint. It is never emitted; the violations say which."""

    def __init__(self, violations: list[Violation]) -> None:
        self.violations = violations
        super().__init__("; ".join(f"({v.constraint}) {v.where}: {v.message}" for v in violations[:5]))


def violations(plan: Plan) -> list[Violation]:
    """Return every broken constraint of the plan, in the order of the letter; empty for a feasible plan."""
    malformed = list(_shape(plan))
    if malformed:
        return malformed
    return [
        *_association(plan),
        *_bandwidth(plan),
        *_min_rates(plan),
        *_windows(plan),
        *_demands(plan),
        *_motion(plan),
        *_separation(plan),
        *_no_fly(plan),
        *_pins(plan),
        *(Violation(constraint=one.rule, where=one.where, message=one.message) for one in breaches(plan)),
        *_air(plan),
    ]


def _air(plan: Plan) -> Iterator[Violation]:
    """Check airspeeds, and that every UAV can go home from every slot."""
    for constraint, where, message in air_faults(plan):
        yield Violation(constraint=constraint, where=where, message=message)


def require_feasible(plan: Plan) -> Plan:
    """Return the plan itself. Raises InfeasiblePlanError if it breaks a constraint."""
    found = violations(plan)
    if found:
        raise InfeasiblePlanError(found)
    return plan


def _shape(plan: Plan) -> Iterator[Violation]:
    scenario = plan.scenario
    for name, table, ids in (
        ("trajectories_m", plan.trajectories_m, scenario.uav_ids),
        ("association", plan.association, scenario.user_ids),
        ("bandwidth_hz", plan.bandwidth_hz, scenario.user_ids),
        ("user_rates_bps", plan.user_rates_bps, scenario.user_ids),
    ):
        if set(table) != set(ids):
            yield Violation(constraint="shape", where=name, message="ids differ from the scenario's")
            continue
        for one, row in table.items():
            if len(row) != scenario.slots:
                yield Violation(constraint="shape", where=f"{name}.{one}", message=f"has {len(row)} slots")
    paths = (point for path in plan.trajectories_m.values() for point in path)
    rows = (row for table in (plan.bandwidth_hz, plan.user_rates_bps) for row in table.values())
    if not all(all(map(isfinite, numbers)) for numbers in chain(paths, rows)):
        yield Violation(constraint="shape", where="plan", message="holds a number that is not finite")


def _association(plan: Plan) -> Iterator[Violation]:
    last = {uav.id: plan.scenario.last_slot(uav) for uav in plan.scenario.uavs}
    end = plan.scenario.slots - 1
    all_stay = {uav for uav, slot in last.items() if slot == end}
    for user, row in plan.association.items():
        if all_stay.issuperset(row):
            continue
        for n, uav in enumerate(row):
            if uav not in last:
                yield Violation(constraint="6a", where=f"{user} slot {n}", message=f"served by unknown '{uav}'")
            elif n > last[uav]:
                yield Violation(constraint="6a", where=f"{user} slot {n}", message=f"served by '{uav}', which has left")


def _bandwidth(plan: Plan) -> Iterator[Violation]:
    limit = {uav.id: uav.bandwidth_hz for uav in plan.scenario.uavs}
    used = {uav: [0.0] * plan.scenario.slots for uav in limit}
    for user, row in plan.bandwidth_hz.items():
        for n, (hertz, uav) in enumerate(zip(row, plan.association[user], strict=True)):
            if hertz < 0:
                yield Violation(constraint="6c", where=f"{user} slot {n}", message=f"bandwidth {hertz} Hz is negative")
            if hertz != 0.0 and uav in used:
                used[uav][n] += hertz
    for uav, row in used.items():
        most = limit[uav] * (1 + BAND_ROUNDING) + ROUNDING_HZ
        for n, hertz in enumerate(row):
            if hertz > most:
                yield Violation(constraint="6c", where=f"{uav} slot {n}", message=f"uses {hertz} of {limit[uav]} Hz")


def _min_rates(plan: Plan) -> Iterator[Violation]:
    for user in plan.scenario.users:
        least = user.min_rate_bps * (1 - MIN_RATE_ROUNDING)
        if min(plan.user_rates_bps[user.id]) >= least:
            continue
        admitted = plan.unmet_min_rate_slots.get(user.id, [])
        for n, rate in enumerate(plan.user_rates_bps[user.id]):
            if rate < least and n not in admitted and user.is_there(n):
                message = f"gets {rate} of {user.min_rate_bps} bit/s"
                yield Violation(constraint="min_rate", where=f"{user.id} slot {n}", message=message)


def _windows(plan: Plan) -> Iterator[Violation]:
    """Check that no user is served before it arrives or after it has left."""
    for user in plan.scenario.users:
        came = 0 if user.arrives_at_slot is None else user.arrives_at_slot
        gone = plan.scenario.slots if user.leaves_at_slot is None else user.leaves_at_slot
        for n in [*range(min(came, plan.scenario.slots)), *range(max(gone, 0), plan.scenario.slots)]:
            hertz, rate = plan.bandwidth_hz[user.id][n], plan.user_rates_bps[user.id][n]
            if hertz != 0.0 or rate != 0.0:
                message = f"has {hertz} Hz and {rate} bit/s, but is not there"
                yield Violation(constraint="window", where=f"{user.id} slot {n}", message=message)


def _demands(plan: Plan) -> Iterator[Violation]:
    """Check that no band is spent on rates beyond what users ask for."""
    for user in plan.scenario.users:
        if user.demand_bps is None:
            continue
        most = user.demand_bps * (1 + DEMAND_ROUNDING)
        for n, rate in enumerate(plan.user_rates_bps[user.id]):
            if rate > most:
                message = f"gets {rate} bit/s, but asks for {user.demand_bps}"
                yield Violation(constraint="demand", where=f"{user.id} slot {n}", message=message)


def _motion(plan: Plan) -> Iterator[Violation]:
    (west, south), (east, north) = plan.scenario.area_m
    for uav in plan.scenario.uavs:
        path = plan.trajectories_m[uav.id]
        yield from _steps(uav, path, uav.max_speed_mps * plan.scenario.slot_duration_s)
        for n, (e, s) in enumerate(path):
            if not (west <= e <= east and south <= s <= north):
                yield Violation(
                    constraint="6f", where=f"{uav.id} slot {n}", message=f"({e}, {s}) m is outside the area"
                )
        if tuple(path[0]) != uav.start_m:
            yield Violation(constraint="6g", where=uav.id, message=f"starts at {path[0]}, not at {uav.start_m}")
        last = path[plan.scenario.last_slot(uav)]
        if uav.end_m is not None and hypot(last[0] - uav.end_m[0], last[1] - uav.end_m[1]) > ROUNDING_M:
            yield Violation(constraint="end", where=uav.id, message=f"ends at {last}, not at {uav.end_m}")


def _steps(uav: Uav, path: list[tuple[float, float]], limit_m: float) -> Iterator[Violation]:
    for n, ((e0, n0), (e1, n1)) in enumerate(pairwise(path)):
        step = hypot(e1 - e0, n1 - n0)
        if step > limit_m + ROUNDING_M:
            yield Violation(constraint="6d", where=f"{uav.id} slot {n}", message=f"moves {step} m of {limit_m} m")


def _separation(plan: Plan) -> Iterator[Violation]:
    limit = plan.scenario.min_separation_m
    flown = {uav.id: plan.trajectories_m[uav.id][: plan.scenario.last_slot(uav) + 1] for uav in plan.scenario.uavs}
    boxes = {uav: _box(path) for uav, path in flown.items()}
    for a, b in combinations(flown, 2):
        if _boxes_apart(boxes[a], boxes[b], limit):
            continue
        apart = [(ea - eb, na - nb) for (ea, na), (eb, nb) in zip(flown[a], flown[b], strict=False)]
        for n, here in enumerate(apart):
            near = distance_to_segment_m((0.0, 0.0), here, apart[n + 1]) if n + 1 < len(apart) else hypot(*here)
            if near < limit - ROUNDING_M:
                where = f"{a} and {b} in slot {n}"
                yield Violation(constraint="6e", where=where, message=f"{near} m apart, less than {limit} m")


def _pins(plan: Plan) -> Iterator[Violation]:
    """Check what the plan was held to: paths to the last bit but for the start's rounding, and who serves whom."""
    for uav, pinned in plan.pins.paths_m.items():
        for n, (there, wanted) in enumerate(zip(plan.trajectories_m[uav], pinned, strict=True)):
            away = hypot(there[0] - wanted[0], there[1] - wanted[1])
            if away > ROUNDING_M:
                yield Violation(constraint="pin", where=f"{uav} slot {n}", message=f"is {away} m off its pinned path")
    for user, given in plan.pins.associations.items():
        row = [given] * plan.scenario.slots if isinstance(given, str) else given
        for n, (served, wanted_by) in enumerate(zip(plan.association[user], row, strict=True)):
            if wanted_by is not None and served != wanted_by:
                message = f"served by '{served}', but pinned to '{wanted_by}'"
                yield Violation(constraint="pin", where=f"{user} slot {n}", message=message)


def _box(path: list[tuple[float, float]]) -> tuple[float, float, float, float]:
    """Return (west, south, east, north) of all that a UAV flies."""
    east, north = zip(*path, strict=True)
    return min(east), min(north), max(east), max(north)


def _boxes_apart(a: tuple[float, float, float, float], b: tuple[float, float, float, float], limit: float) -> bool:
    """Return whether the bounding boxes of two paths alone keep them more than `limit` apart."""
    return any(a[axis] > b[axis + 2] + limit or b[axis] > a[axis + 2] + limit for axis in (0, 1))


def _no_fly(plan: Plan) -> Iterator[Violation]:
    """Check straight legs against the inside of each zone: of a disc by distance, of a polygon by shapely."""
    for number, zone in enumerate(plan.scenario.no_fly):
        for uav in plan.scenario.uavs:
            path = plan.trajectories_m[uav.id][: plan.scenario.last_slot(uav) + 1]
            for n, (here, there) in enumerate(pairwise([*path, path[-1]])):
                depth = no_fly_depth_m(zone, here, there)
                if depth > ROUNDING_M:
                    message = f"flies {depth:.3g} m inside"
                    yield Violation(constraint="no_fly", where=f"{uav.id} slot {n} no_fly.{number}", message=message)


def no_fly_depth_m(zone: NoFlyDisc | NoFlyPolygon, here: tuple[float, float], there: tuple[float, float]) -> float:
    """Return how far the leg reaches into the zone: below the disc's radius, or metres of it inside the polygon."""
    if isinstance(zone, NoFlyDisc):
        return zone.radius_m - distance_to_segment_m(zone.center_m, here, there)
    outline = Polygon(zone.vertices_m)
    if here == there:
        inside = GeoPoint(here)
        return outline.boundary.distance(inside) if outline.contains(inside) else 0.0
    leg = LineString([here, there]).intersection(outline)
    middle_m = outline.boundary.distance(leg.centroid) if not leg.is_empty else 0.0
    return float(min(leg.length, middle_m))
