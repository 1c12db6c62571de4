"""How fast each leg must be flown to be on time, although changes of speed, corners and stops cost time.

A waypoint that is flown through counts as reached, and the next leg begins, one acceptance radius before it; there
the vehicle has the lowest of both legs' speeds and what the turn allows. A waypoint with a hold is budgeted to count
as reached when its slot begins (that is when the hold starts), still moving; after the hold it is left from rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from math import acos, dist, hypot, inf, isfinite, pi, sqrt, tan

from skyfolio.planner.geometry import Point

_PASSES = 8
"""Speeds and the speeds at the corners between them depend on each other; this many passes settle them."""
_ENTRY_IN_FLIGHT = 0.5
"""The course of a vehicle in flight is not known: half of its speed helps, on average."""
_LEAST_RADIUS_M = 0.2
_JERK_PASSES = 4
"""With a jerk limit the mean acceleration depends on the speed that is computed."""
_LEAST_CHANGE_MPS = 0.5
_RADIUS_PER_LEG = 1 / 3
_HALVINGS = 40
_STRAIGHT = 1 - 1e-9


@dataclass(frozen=True, kw_only=True)
class VehicleModel:
    """How a multirotor flies its legs; the defaults are PX4's.

    acceleration_mps2: horizontal (MPC_ACC_HOR). braking_mps2: what stops and corners are planned with, a little less.
    max_speed_mps: what a speed command may ask for (MPC_XY_VEL_MAX). min_speed_mps: slower legs are flown at this
    speed and end in a hold. acceptance_radius_m: a waypoint counts as reached this far away (param2 of NAV_WAYPOINT);
    less where the legs beside it are short. jerk_mps3: how fast the acceleration itself builds up (WPNAV_JERK), and
    jerk_from_rest_mps3 the same where all of it counts, on the first leg (MPC_JERK_AUTO: PX4 hardly brakes at corners).
    departure_mps2: the acceleration with which it really leaves a place of rest, for predictions of a first leg.
    cruise_mps: its own speed if none is ordered (MPC_XY_CRUISE, WPNAV_SPEED). rests_in_plan: its autopilot plans
    each leg from rest to rest and blends the ends (ArduCopter's S-curves), so that a short leg is flown no faster than
    it could be braked from, whatever speed is asked for. settle_s: what a hold costs beside its own seconds, because
    it only begins once the vehicle has come to rest. hold_step_s: holds are multiples of this (0: any length).
    `models.model_from_parameters` makes one from what a vehicle says about itself.
    """

    acceleration_mps2: float = 3.0
    braking_mps2: float = 2.4
    max_speed_mps: float = 12.0
    min_speed_mps: float = 0.2
    acceptance_radius_m: float = 1.0
    jerk_mps3: float = inf
    jerk_from_rest_mps3: float = inf
    departure_mps2: float = inf
    cruise_mps: float = 5.0
    rests_in_plan: bool = False
    settle_s: float = 0.0
    hold_step_s: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name == "rests_in_plan":
                continue
            if name in ("settle_s", "hold_step_s"):
                if not (isfinite(value) and value >= 0):
                    raise ValueError(f"{name}: {value} must be a finite number of seconds, at least 0")
            elif not (value > 0 and (isfinite(value) or name.startswith(("jerk", "departure")))):
                raise ValueError(f"{name}: {value} must be a finite number above 0")

    def from_rest(self) -> VehicleModel:
        """Return the model for a leg that begins at rest."""
        return replace(self, jerk_mps3=min(self.jerk_mps3, self.jerk_from_rest_mps3))

    def departing(self) -> VehicleModel:
        """Return the model of its first seconds from rest, whatever speed was ordered."""
        return replace(self.from_rest(), acceleration_mps2=min(self.acceleration_mps2, self.departure_mps2))


def cruise_speed(
    distance_m: float, duration_s: float, *, entry_mps: float, leave_mps: float, model: VehicleModel
) -> float:
    """Return the speed v (m/s) that covers a leg in time, entered at `entry_mps` and left at `leave_mps`, both <= v.

    With acceleration a and braking b the changes cost (v - entry)^2 / 2av + (v - leave)^2 / 2bv seconds beside distance
    / v: a quadratic in v. If no speed is fast enough it is the one that is least late.
    """
    speed = distance_m / duration_s
    for _ in range(1 if model.jerk_mps3 == inf else _JERK_PASSES):
        change_mps = max(speed - min(entry_mps, leave_mps), _LEAST_CHANGE_MPS)
        a = mean_acceleration(change_mps, model.acceleration_mps2, model.jerk_mps3)
        b = mean_acceleration(change_mps, model.braking_mps2, model.jerk_mps3)
        square = 1 / (2 * a) + 1 / (2 * b)
        linear = duration_s + entry_mps / a + leave_mps / b
        constant = distance_m + entry_mps**2 / (2 * a) + leave_mps**2 / (2 * b)
        discriminant = linear**2 - 4 * square * constant
        speed = sqrt(constant / square) if discriminant < 0 else 2 * constant / (linear + sqrt(discriminant))
    return speed


def lateness(distance_m: float, duration_s: float, *, entry_mps: float, leave_mps: float, model: VehicleModel) -> float:
    """Return how many seconds the fastest flight of such a leg is late; 0 if `cruise_speed` is in time."""
    change_mps = max(distance_m / duration_s - min(entry_mps, leave_mps), _LEAST_CHANGE_MPS)
    a = mean_acceleration(change_mps, model.acceleration_mps2, model.jerk_mps3)
    b = mean_acceleration(change_mps, model.braking_mps2, model.jerk_mps3)
    square = 1 / (2 * a) + 1 / (2 * b)
    constant = distance_m + entry_mps**2 / (2 * a) + leave_mps**2 / (2 * b)
    fastest_s = 2 * sqrt(constant * square) - entry_mps / a - leave_mps / b
    return max(0.0, fastest_s - duration_s)


def mean_acceleration(change_mps: float, limit_mps2: float, jerk_mps3: float) -> float:
    """Return the mean acceleration (m/s^2) of a change of speed with limited acceleration and jerk.

    It begins and ends without acceleration, and takes `change / limit + limit / jerk` seconds if the limit is reached,
    else `2 sqrt(change / jerk)`.
    """
    if jerk_mps3 == inf:
        return limit_mps2
    if change_mps >= limit_mps2**2 / jerk_mps3:
        return change_mps / (change_mps / limit_mps2 + limit_mps2 / jerk_mps3)
    return sqrt(change_mps * jerk_mps3) / 2


def way_from_rest_m(speed_mps: float, time_s: float, model: VehicleModel) -> float:
    """Return the metres flown in `time_s` from rest towards a cruise speed, with limited acceleration and jerk.

    The acceleration builds up for `ramp` seconds, stays for `steady`, and fades for `ramp` again.
    """
    limit, jerk = model.acceleration_mps2, model.jerk_mps3
    ramp = 0.0 if jerk == inf else min(limit / jerk, sqrt(speed_mps / jerk))
    peak = limit if jerk == inf else jerk * ramp
    steady = speed_mps / peak - ramp
    way = speed = 0.0
    for lasts, begins, change in ((ramp, 0.0, 1.0), (steady, peak, 0.0), (ramp, peak, -1.0)):
        t = min(max(time_s, 0.0), lasts)
        rate = change * jerk if lasts > 0 and change else 0.0
        way += speed * t + begins * t**2 / 2 + rate * t**3 / 6
        speed += begins * t + rate * t**2 / 2
        time_s -= lasts
    return way + speed_mps * max(time_s, 0.0)


def fastest_on_leg(distance_m: float, model: VehicleModel) -> float:
    """Return the speed (m/s) reached on a leg of this length: the model's, or less from rest to rest.

    If the autopilot plans legs from rest to rest, speeding up to v and braking again take `v` times the mean seconds of
    both changes in metres.
    """
    if not model.rests_in_plan:
        return model.max_speed_mps
    low, high = 0.0, model.max_speed_mps
    for _ in range(_HALVINGS):
        speed = (low + high) / 2
        mean_mps2 = mean_acceleration(speed, model.acceleration_mps2, model.jerk_mps3)
        low, high = (speed, high) if speed**2 / mean_mps2 <= distance_m else (low, speed)
    return low


def acceptance_radii(points: Sequence[Point], model: VehicleModel) -> list[float]:
    """Return for each point the metres: the model's, but at most a third of the shorter leg beside it."""
    legs = [dist(p, q) for p, q in pairwise(points)]
    shortest = [min(before, after) for before, after in zip([inf, *legs], [*legs, inf], strict=True)]
    return [max(_LEAST_RADIUS_M, min(model.acceptance_radius_m, leg * _RADIUS_PER_LEG)) for leg in shortest]


class Pacer:
    """Computes the speeds for the legs between consecutive points.

    points: (n + 1, 2) metres east/north, the last one a halt. halts: (n + 1,) whether the vehicle comes to rest there.
    times_s: (n,) seconds from slot boundary to slot boundary. in_flight: the first point is passed, not left from rest.
    """

    def __init__(
        self,
        points: Sequence[Point],
        halts: Sequence[bool],
        times_s: Sequence[float],
        *,
        in_flight: bool,
        model: VehicleModel,
    ) -> None:
        self._halts, self._times_s = halts, times_s
        self._in_flight, self._model = in_flight, model
        self._lengths = [dist(p, q) for p, q in pairwise(points)]
        self._radii = acceptance_radii(points, model)
        self._cosines = [
            0.0 if halt or at == 0 else _cosine_of_turn(*points[at - 1 : at + 2]) for at, halt in enumerate(halts)
        ]

    def speeds(self) -> list[float]:
        """Return the speeds, (n,) m/s, not yet limited to what the vehicle flies."""
        speeds = [length / time_s for length, time_s in zip(self._lengths, self._times_s, strict=True)]
        for _ in range(_PASSES):
            late_s, paced = 0.0, []
            for leg in range(len(speeds)):
                speed, late_s = self._speed(leg, speeds, late_s)
                paced.append(speed)
            speeds = paced
        return speeds

    def _speed(self, leg: int, speeds: list[float], late_s: float) -> tuple[float, float]:
        """Return the speed of one leg, given the others', and how late it ends.

        A leg that is entered late has less time.

        A leg flown through ends one radius early in way and in time.
        """
        distance_m = self._lengths[leg]
        time_s = max(self._times_s[leg] - late_s, self._times_s[leg] / 2)
        if leg > 0 and not self._halts[leg]:
            radius = self._radii[leg]
            distance_m += radius * self._cosines[leg]
            time_s += radius / max(speeds[leg - 1], self._model.min_speed_mps)
        if self._halts[leg + 1]:
            distance_m -= self._radii[leg + 1]
            leave_mps = sqrt(self._model.braking_mps2 * self._radii[leg + 1])
        else:
            leave_mps = self._through(leg + 1, speeds)
        cruise = speeds[leg]
        leg_of = {"entry_mps": min(cruise, self._entry(leg, speeds)), "leave_mps": min(cruise, leave_mps)}
        distance_m = max(0.0, distance_m)
        model = self._model.from_rest() if leg == 0 and not self._in_flight else self._model
        speed = cruise_speed(distance_m, time_s, model=model, **leg_of)
        still_late_s = lateness(distance_m, time_s, model=model, **leg_of)
        return speed, 0.0 if self._halts[leg + 1] else still_late_s

    def _entry(self, leg: int, speeds: list[float]) -> float:
        """Return the speed along the leg at its beginning; negative after a sharp turn, as it still flies away."""
        if leg == 0:
            return _ENTRY_IN_FLIGHT * speeds[0] if self._in_flight else 0.0
        return 0.0 if self._halts[leg] else self._through(leg, speeds) * self._cosines[leg]

    def _through(self, at: int, speeds: list[float]) -> float:
        """Return the speed at a point flown through: the turn must fit in the acceptance radius, as PX4 has it."""
        cosine = self._cosines[at]
        turn_mps = inf
        if cosine < _STRAIGHT:
            inside = (pi - acos(max(-1.0, cosine))) / 2
            turn_mps = sqrt(self._model.braking_mps2 * self._radii[at] * tan(inside))
        return min(speeds[at - 1], speeds[at], turn_mps)


def _cosine_of_turn(before: Point, at: Point, after: Point) -> float:
    """Return 1 for straight on, -1 for straight back; 0 if a leg has no length."""
    (ax, ay), (bx, by), (cx, cy) = before, at, after
    lengths = hypot(bx - ax, by - ay) * hypot(cx - bx, cy - by)
    return ((bx - ax) * (cx - bx) + (by - ay) * (cy - by)) / lengths if lengths else 0.0
