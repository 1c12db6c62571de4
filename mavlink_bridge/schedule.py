"""A slot path as stops and timed legs: the part of the compiler that no autopilot's habits touch.

Slot n begins at n * T. Slots spent at one place become one stop with a hold; between stops the UAV flies a straight
leg. Legs and holds (with what settling costs) together last exactly as long as the slots: the last slot is held at the
last point. A stop flown through straight on at an unchanged speed is no stop at all and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist, floor, isclose

from skyfolio.mavlink_bridge.pace import Pacer, VehicleModel, acceptance_radii
from skyfolio.planner.geometry import Point

SAME_PLACE_M = 0.1
"""Points closer than this are one place: well below what GPS navigation resolves."""
STRAIGHT_M = 0.1
"""A point about this close to the straight way between its neighbours is on it."""
SAME_LEVEL_M = 0.5
"""Slots at one place whose altitudes differ by less are one stop, at the greatest of them."""
LEVEL_M = 0.02
"""A stop is flown through straight on only where altitudes stay the same but for this much."""
CLIMB_MPS = 1.0
"""Legs last at least as long as their climb or descent at this rate takes: below what autopilots do by default."""
SAME_SPEED = 0.02
"""Relative: legs this alike are flown at one speed, 2 % of a 25 m leg is half a metre."""


@dataclass(frozen=True, kw_only=True)
class Stop:
    """A place to be at: reached when slot `slot` begins; it counts as reached `radius_m` away.

    altitude_m: how high it is there, in whatever datum the path has.

    It is left `hold_s` later, and `settle_s` later still where the vehicle must come to rest before it begins to hold.
    """

    slot: int
    point_m: Point
    hold_s: float
    radius_m: float
    settle_s: float = 0.0
    altitude_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A straight flight to stop `to`: `speed_mps` is the cruise speed that covers `distance_m` in `duration_s`."""

    to: int
    distance_m: float
    duration_s: float
    speed_mps: float


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Stops in flying order and the legs between them; an airborne schedule has a leg to its first stop too."""

    stops: tuple[Stop, ...]
    legs: tuple[Leg, ...]

    @property
    def duration_s(self) -> float:
        """Return the seconds of all legs and holds."""
        return sum(leg.duration_s for leg in self.legs) + sum(stop.hold_s + stop.settle_s for stop in self.stops)

    def leg_to(self, stop: int) -> Leg | None:
        """Return the leg that ends at stop number `stop`, None if the schedule begins there."""
        return next((leg for leg in self.legs if leg.to == stop), None)


def ground_schedule(
    path_m: Sequence[Point], slot_s: float, model: VehicleModel, altitudes_m: Sequence[float] | None = None
) -> Schedule:
    """Return the schedule of a UAV that waits, at rest, at the slot-0 point when slot 0 begins.

    path_m: (n_slots, 2), metres east/north of the origin. slot_s: slot duration in seconds. altitudes_m: (n_slots,);
    default: level flight.
    """
    stops = _merge(path_m, slot_s, altitudes_m, first=0, radius_m=model.acceptance_radius_m)
    return _timed(stops, [slot_s] * (len(stops) - 1), approach=None, model=model)


def airborne_schedule(
    path_m: Sequence[Point],
    slot_s: float,
    first_leg_s: float,
    model: VehicleModel,
    altitudes_m: Sequence[float] | None = None,
) -> Schedule:
    """Return the schedule of a UAV in flight at the slot-0 point that has `first_leg_s` to reach the slot-1 point.

    With a single slot left there is nowhere to go: it holds at the slot-0 point for `first_leg_s`.
    """
    if len(path_m) == 1:
        only = Stop(slot=0, point_m=path_m[0], hold_s=first_leg_s, radius_m=model.acceptance_radius_m)
        return Schedule(stops=(replace(only, altitude_m=altitudes_m[0] if altitudes_m else 0.0),), legs=())
    stops = _merge(path_m, slot_s, altitudes_m, first=1, radius_m=model.acceptance_radius_m)
    begins = replace(stops[0], point_m=path_m[0], altitude_m=altitudes_m[0] if altitudes_m else 0.0)
    return _timed(stops, [first_leg_s] + [slot_s] * (len(stops) - 1), approach=begins, model=model)


def _merge(
    path_m: Sequence[Point], slot_s: float, altitudes_m: Sequence[float] | None, *, first: int, radius_m: float
) -> list[Stop]:
    """Return the runs of slots within SAME_PLACE_M of their first point, from slot `first` on, as stops.

    The last slot is held.
    """
    levels = altitudes_m or [0.0] * len(path_m)
    runs: list[list[int]] = []
    for slot in range(first, len(path_m)):
        is_level = bool(runs) and abs(levels[runs[-1][0]] - levels[slot]) < SAME_LEVEL_M
        if is_level and dist(path_m[runs[-1][0]], path_m[slot]) < SAME_PLACE_M:
            runs[-1].append(slot)
        else:
            runs.append([slot])
    return [
        Stop(
            slot=run[0],
            point_m=path_m[run[0]],
            hold_s=(len(run) - 1 + (run is runs[-1])) * slot_s,
            radius_m=radius_m,
            altitude_m=max(levels[slot] for slot in run),
        )
        for run in runs
    ]


def _timed(stops: list[Stop], times_s: list[float], *, approach: Stop | None, model: VehicleModel) -> Schedule:
    """Return the schedule with a speed for every leg; `approach`: where the first leg begins in flight.

    A leg too short for the least speed ends early, in a longer hold.
    """
    before = [] if approach is None else [approach]
    points = [stop.point_m for stop in [*before, *stops]]
    flown_s = list(times_s)
    for leg, (p, q) in enumerate(pairwise([*before, *stops])):
        climb_s = abs(q.altitude_m - p.altitude_m) / CLIMB_MPS
        flown_s[leg] = min(times_s[leg], max(dist(p.point_m, q.point_m) / model.min_speed_mps, climb_s))
        to = leg + 1 - len(before)
        stops[to] = replace(stops[to], hold_s=stops[to].hold_s + times_s[leg] - flown_s[leg])
    times_s = _settle(stops, times_s, flown_s, first=1 - len(before), model=model)
    halts = [False] * len(before) + [stop.hold_s + stop.settle_s > 0 for stop in stops]
    pacer = Pacer(points, halts, times_s, in_flight=approach is not None, model=model)
    radii = acceptance_radii(points, model)[len(before) :]
    legs = [
        Leg(
            to=leg + 1 - len(before),
            distance_m=dist(points[leg], points[leg + 1]),
            duration_s=flown_s[leg],
            speed_mps=min(max(speed, model.min_speed_mps), model.max_speed_mps),
        )
        for leg, speed in enumerate(pacer.speeds())
    ]
    stops = [replace(stop, radius_m=radius) for stop, radius in zip(stops, radii, strict=True)]
    return _without_straight_stops(stops, legs, approach)


def _settle(
    stops: list[Stop], times_s: list[float], flown_s: list[float], *, first: int, model: VehicleModel
) -> list[float]:
    """Take settling out of each hold, and round it down to what is stored; the leg after it gets what is left.

    Changes `stops` and `flown_s`; returns the legs' times. Leg number n ends at stop `first + n`.
    """
    times_s = list(times_s)
    for number, stop in enumerate(stops):
        if stop.hold_s <= 0 or not (model.settle_s or model.hold_step_s):
            continue
        at_rest = number == 0 and first == 1  # it waits there already
        settle_s = 0.0 if at_rest else min(model.settle_s, stop.hold_s)
        rest_s = stop.hold_s - settle_s
        hold_s = rest_s if model.hold_step_s == 0 else model.hold_step_s * floor(rest_s / model.hold_step_s + 1e-9)
        leg = number + 1 - first
        if leg < len(times_s):
            times_s[leg] += rest_s - hold_s
            flown_s[leg] += rest_s - hold_s
        else:
            settle_s += rest_s - hold_s
        stops[number] = replace(stop, hold_s=hold_s, settle_s=settle_s)
    return times_s


def _without_straight_stops(stops: list[Stop], legs: list[Leg], approach: Stop | None) -> Schedule:
    """Leave out stops that are flown through straight on at one speed: a vehicle does not notice them."""
    kept: list[Stop] = []
    merged: list[Leg] = []
    origin = approach
    leg_to = {leg.to: leg for leg in legs}
    for number, stop in enumerate(stops):
        leg = leg_to.get(number)
        if leg is not None and merged and kept and _passed_straight(origin, kept[-1], stop, merged[-1], leg):
            kept.pop()
            leg = _joined(merged.pop(), leg)
        elif kept:
            origin = kept[-1]
        kept.append(stop)
        if leg is not None:
            merged.append(replace(leg, to=len(kept) - 1))
    return Schedule(stops=tuple(kept), legs=tuple(merged))


def _joined(first: Leg, second: Leg) -> Leg:
    """Return both legs as one, at the speed that takes as long."""
    distance_m = first.distance_m + second.distance_m
    cruising_s = first.distance_m / first.speed_mps + second.distance_m / second.speed_mps
    return replace(
        second,
        distance_m=distance_m,
        duration_s=first.duration_s + second.duration_s,
        speed_mps=distance_m / cruising_s if cruising_s > 0 else second.speed_mps,
    )


def _passed_straight(origin: Stop | None, through: Stop, to: Stop, before: Leg, after: Leg) -> bool:
    """Return whether `through` is passed straight on from `origin` to `to`, without a change of speed."""
    if origin is None or through.hold_s + through.settle_s > 0:
        return False
    if not isclose(before.speed_mps, after.speed_mps, rel_tol=SAME_SPEED):
        return False
    if max(abs(through.altitude_m - one.altitude_m) for one in (origin, to)) > LEVEL_M:
        return False
    straight_m = dist(origin.point_m, to.point_m)
    return before.distance_m + after.distance_m - straight_m < STRAIGHT_M**2 / max(straight_m, STRAIGHT_M)
