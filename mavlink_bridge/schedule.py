"""A slot path as stops and timed legs: the part of the compiler that no autopilot's habits touch.

Slot n begins at n * T. Slots spent at one place become one stop with a hold; between stops the UAV flies a straight
leg. Legs and holds together last exactly as long as the slots: the last slot is held at the last point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt

SAME_PLACE_M = 0.1
"""Points closer than this are one place: well below what GPS navigation resolves."""

Point = tuple[float, float]
"""East, north in metres from the scenario's origin."""


@dataclass(frozen=True, kw_only=True)
class VehicleModel:
    """How a multirotor flies its legs; the defaults are PX4's.

    acceleration_mps2: horizontal, both ways (MPC_ACC_HOR). max_speed_mps: what a speed command may ask for
    (MPC_XY_VEL_MAX). min_speed_mps: slower legs are flown at this speed and end in a hold.
    acceptance_radius_m: a waypoint counts as reached this far away (param2 of NAV_WAYPOINT).
    """

    acceleration_mps2: float = 3.0
    max_speed_mps: float = 12.0
    min_speed_mps: float = 0.2
    acceptance_radius_m: float = 1.0

    def __post_init__(self) -> None:
        for name in ("acceleration_mps2", "max_speed_mps", "min_speed_mps", "acceptance_radius_m"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value} must be a finite number above 0")


@dataclass(frozen=True, kw_only=True)
class Stop:
    """A place to be at: reached when slot `slot` begins, left `hold_s` later."""

    slot: int
    point_m: Point
    hold_s: float


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
        """Seconds of all legs and holds."""
        return sum(leg.duration_s for leg in self.legs) + sum(stop.hold_s for stop in self.stops)

    def leg_to(self, stop: int) -> Leg | None:
        """The leg that ends at stop number `stop`, None where the schedule begins there."""
        return next((leg for leg in self.legs if leg.to == stop), None)


def ground_schedule(path_m: Sequence[Point], slot_s: float, model: VehicleModel) -> Schedule:
    """Schedule of a UAV that waits, at rest, at the slot-0 point when slot 0 begins.

    path_m: (n_slots, 2), metres east/north of the origin. slot_s: slot duration in seconds.
    """
    stops = _merge(path_m, slot_s, first=0)
    return _timed(stops, [slot_s] * (len(stops) - 1), approach=None, model=model)


def airborne_schedule(path_m: Sequence[Point], slot_s: float, first_leg_s: float, model: VehicleModel) -> Schedule:
    """Schedule of a UAV in flight at the slot-0 point that has `first_leg_s` to reach the slot-1 point.

    With a single slot left there is nowhere to go: it holds at the slot-0 point for `first_leg_s`.
    """
    if len(path_m) == 1:
        stop = Stop(slot=0, point_m=path_m[0], hold_s=first_leg_s)
        return Schedule(stops=(stop,), legs=())
    stops = _merge(path_m, slot_s, first=1)
    return _timed(stops, [first_leg_s] + [slot_s] * (len(stops) - 1), approach=path_m[0], model=model)


def cruise_speed(
    distance_m: float, duration_s: float, *, entry: float, leave: float, acceleration_mps2: float
) -> float:
    """Speed v that covers a leg in time although it starts at `entry` * v and ends at `leave` * v.

    0 is rest, 1 is flown through. With acceleration a the speed changes cost (1 - entry)^2 v / 2a and
    (1 - leave)^2 v / 2a seconds, so duration = distance / v + k v / 2a. Where no speed is fast enough it is the one
    that gets furthest.
    """
    k = (1 - entry) ** 2 + (1 - leave) ** 2
    root = sqrt(max(0.0, duration_s**2 - 2 * k * distance_m / acceleration_mps2))
    return 2 * distance_m / (duration_s + root)


def _merge(path_m: Sequence[Point], slot_s: float, *, first: int) -> list[Stop]:
    """Runs of slots within SAME_PLACE_M of their first point, from slot `first` on; the last slot is held."""
    runs: list[list[int]] = []
    for slot in range(first, len(path_m)):
        if runs and _length(path_m[runs[-1][0]], path_m[slot]) < SAME_PLACE_M:
            runs[-1].append(slot)
        else:
            runs.append([slot])
    return [
        Stop(slot=run[0], point_m=path_m[run[0]], hold_s=(len(run) - 1 + (run is runs[-1])) * slot_s) for run in runs
    ]


def _timed(stops: list[Stop], times_s: list[float], *, approach: Point | None, model: VehicleModel) -> Schedule:
    """Give every leg its speed; a leg too short to be flown slowly enough ends early and its stop holds the rest."""
    before = 0 if approach is None else 1
    points = [stop.point_m for stop in stops] if approach is None else [approach, *(stop.point_m for stop in stops)]
    kept = [_ENTRY_IN_FLIGHT if before else 0.0]
    legs = []
    for start, time_s in enumerate(times_s):
        to = start + 1 - before
        distance = _length(points[start], points[start + 1])
        kept.append(_through(stops[to], points, start + 1))
        speed = cruise_speed(
            distance, time_s, entry=kept[start], leave=kept[start + 1], acceleration_mps2=model.acceleration_mps2
        )
        flown_s = time_s
        if speed < model.min_speed_mps:
            speed, flown_s = model.min_speed_mps, min(time_s, distance / model.min_speed_mps)
            stops[to] = replace(stops[to], hold_s=stops[to].hold_s + time_s - flown_s)
            kept[start + 1] = 0.0
        legs.append(Leg(to=to, distance_m=distance, duration_s=flown_s, speed_mps=min(speed, model.max_speed_mps)))
    return Schedule(stops=tuple(stops), legs=tuple(legs))


_ENTRY_IN_FLIGHT = 0.5
"""Where a vehicle in flight was heading is not known: half of its speed helps, on average."""


def _through(stop: Stop, points: list[Point], at: int) -> float:
    """Fraction of the cruise speed kept at a stop: none where it holds, the cosine of the turn elsewhere."""
    if stop.hold_s > 0 or at + 1 >= len(points):
        return 0.0
    (ax, ay), (bx, by), (cx, cy) = points[at - 1], points[at], points[at + 1]
    lengths = _length(points[at - 1], points[at]) * _length(points[at], points[at + 1])
    if lengths == 0:
        return 0.0
    return max(0.0, ((bx - ax) * (cx - bx) + (by - ay) * (cy - by)) / lengths)


def _length(a: Point, b: Point) -> float:
    return hypot(b[0] - a[0], b[1] - a[1])
