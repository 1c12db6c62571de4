"""How a multirotor moves: pure kinematics with limits, no modes, no MAVLink, no clock.

Frame: metres east, north and up of the vehicle's spawn point (up = 0). The ground is at `Body.ground_m`. Yaw in
radians, 0 = north, clockwise positive. `step` takes a body and its guidance, and returns the body a moment later. With
a jerk limit (ArduCopter's WPNAV_JERK) the acceleration builds up and fades, which is what makes short legs late.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

from skyfolio.sim.airframe import GRAVITY_MPS2

TERMINAL_SPEED_MPS = 20.0
BRAKING_SHARE = 0.8
"""Share of the acceleration limit used to plan a stop; the rest absorbs the time step and the last turn."""
APPROACH_GAIN_PER_S = 1.5
"""Close to the target, speed is this much per metre of distance (a soft arrival instead of an abrupt one)."""
YAW_RATE_RAD_S = math.radians(60.0)
COURSE_SPEED_MPS = 0.5
"""Below this ground speed the nose keeps its direction."""
_HALVINGS = 14
JERK_SHARE = 0.6
"""Share of the jerk limit used to plan a stop."""
JERK_LEAD_S = 0.4
"""How far ahead a jerk-limited stop is begun: its acceleration has to turn round first."""
SPEED_GAIN_PER_S = 4.0
"""Close to the wanted speed, a jerk-limited acceleration is this much per m/s of the difference."""
TURNING_UP_MPS2 = 1.8
"""How a PX4 slows down once it has passed an altitude at speed: from 2.6 m/s up to 1.1 m/s down in 2 s (recorded)."""
TRACKING_GAIN_PER_S = 1.0
"""A streamed setpoint is followed with its velocity plus this much per metre the vehicle is off."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """What the airframe and its tuning allow. Defaults are PX4's for a multirotor, parameter names beside them."""

    max_speed_mps: float = 12.0  # MPC_XY_VEL_MAX
    cruise_speed_mps: float = 5.0  # MPC_XY_CRUISE
    acceleration_mps2: float = 3.0  # MPC_ACC_HOR
    climb_mps: float = 3.0  # MPC_Z_V_AUTO_UP, MPC_Z_VEL_MAX_UP
    descend_mps: float = 1.5  # MPC_Z_V_AUTO_DN
    land_mps: float = 0.7  # MPC_LAND_SPEED
    land_slow_below_m: float = 10.0  # MPC_LAND_ALT1
    climb_acceleration_mps2: float = 4.0  # MPC_ACC_UP_MAX
    descend_acceleration_mps2: float = 3.0  # MPC_ACC_DOWN_MAX
    jerk_mps3: float = math.inf  # WPNAV_JERK; infinite: the horizontal acceleration jumps

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            unlimited = field.name == "jerk_mps3" and value == math.inf
            if not (unlimited or 0.0 < value < math.inf):
                raise ValueError(f"{field.name} must be a positive number, got {value}")


class Body(NamedTuple):
    """Position (m), velocity (m/s), heading (rad) and horizontal acceleration (m/s^2) of one vehicle.

    ground_m: how high the ground is beneath it, above the spawn point.
    """

    east_m: float = 0.0
    north_m: float = 0.0
    up_m: float = 0.0
    east_mps: float = 0.0
    north_mps: float = 0.0
    up_mps: float = 0.0
    yaw_rad: float = 0.0
    east_mps2: float = 0.0
    north_mps2: float = 0.0
    ground_m: float = 0.0

    @property
    def ground_speed_mps(self) -> float:
        """Horizontal speed, m/s."""
        return math.hypot(self.east_mps, self.north_mps)

    @property
    def on_ground(self) -> bool:
        """Whether the skids touch the ground."""
        return self.up_m <= self.ground_m

    def distance_to(self, east_m: float, north_m: float) -> float:
        """Return the horizontal distance to a point, metres."""
        return math.hypot(east_m - self.east_m, north_m - self.north_m)


class Guidance(NamedTuple):
    """What to fly: towards a point at `speed_mps`, to be passed at `passing_mps`; `landing` sinks to the ground.

    `passing_up_mps`: how fast its altitude may be passed, up or down.
    `velocity_mps` (east, north, up) makes the point a moving one, as streamed setpoints do; `yaw_rad` None turns the
    nose along the course.
    """

    east_m: float
    north_m: float
    up_m: float
    speed_mps: float
    passing_mps: float = 0.0
    landing: bool = False
    velocity_mps: tuple[float, float, float] | None = None
    yaw_rad: float | None = None
    passing_up_mps: float = 0.0


def approach_speed(distance_m: float, acceleration_mps2: float, passing_mps: float = 0.0) -> float:
    """Return the highest speed from which `passing_mps` is still met `distance_m` ahead (square root, then linear)."""
    linear_m = acceleration_mps2 / APPROACH_GAIN_PER_S**2
    if distance_m < linear_m:
        stop = APPROACH_GAIN_PER_S * distance_m
    else:
        stop = math.sqrt(2.0 * acceleration_mps2 * (distance_m - linear_m / 2.0))
    return math.hypot(stop, passing_mps)


def jerk_limited_approach(distance_m: float, acceleration_mps2: float, jerk_mps3: float, passing_mps: float) -> float:
    """Return the highest speed from which `passing_mps` is met `distance_m` ahead, with acceleration built up by jerk.

    Slowing by dv takes T = 2 sqrt(dv / j), or dv / a + a / j once the full acceleration is reached, and covers
    (v + passing) T / 2 metres: the mean speed, because the ramps are symmetric.
    """
    low, high = 0.0, max(1.0, 2.0 * distance_m + 1.0)
    corner = acceleration_mps2**2 / jerk_mps3
    for _ in range(_HALVINGS):
        change = (low + high) / 2.0
        if change <= corner:
            time_s = 2.0 * math.sqrt(change / jerk_mps3)
        else:
            time_s = change / acceleration_mps2 + acceleration_mps2 / jerk_mps3
        if (2.0 * passing_mps + change) / 2.0 * time_s > distance_m:
            high = change
        else:
            low = change
    return passing_mps + min(low, APPROACH_GAIN_PER_S * distance_m)


def stopping_point(body: Body, limits: Limits) -> tuple[float, float]:
    """Return (east_m, north_m) where the vehicle comes to rest when it brakes now."""
    speed, braking, jerk = (
        body.ground_speed_mps,
        BRAKING_SHARE * limits.acceleration_mps2,
        JERK_SHARE * limits.jerk_mps3,
    )
    gentle = speed <= braking**2 / jerk
    reach_s = math.sqrt(speed / jerk) if gentle else (speed / braking + braking / jerk) / 2.0
    return body.east_m + body.east_mps * reach_s, body.north_m + body.north_mps * reach_s


def step(body: Body, guidance: Guidance, limits: Limits, dt_s: float) -> Body:
    """Return the body `dt_s` later under power; speeds and accelerations stay within `limits`."""
    east_mps2, north_mps2 = _horizontal_acceleration(body, guidance, limits, dt_s)
    east_m, north_m, up_m, was_east_mps, was_north_mps, was_up_mps, _, _, _, ground_m = body
    east_mps, north_mps = was_east_mps + east_mps2 * dt_s, was_north_mps + north_mps2 * dt_s
    up_mps = _vertical_velocity(body, guidance, limits, dt_s)
    up_m += (was_up_mps + up_mps) / 2.0 * dt_s
    if up_m <= ground_m:
        up_m, up_mps = ground_m, 0.0
        if guidance.landing:
            east_mps = north_mps = east_mps2 = north_mps2 = 0.0
    return Body(
        east_m + (was_east_mps + east_mps) / 2.0 * dt_s,
        north_m + (was_north_mps + north_mps) / 2.0 * dt_s,
        up_m,
        east_mps,
        north_mps,
        up_mps,
        _yaw(body, guidance, east_mps, north_mps, dt_s),
        east_mps2,
        north_mps2,
        ground_m,
    )


def fall(body: Body, dt_s: float) -> Body:
    """Return the body `dt_s` later with the motors stopped; at rest once it is on the ground."""
    if body.on_ground:
        return body._replace(up_m=body.ground_m, east_mps=0.0, north_mps=0.0, up_mps=0.0, east_mps2=0.0, north_mps2=0.0)
    up_mps = max(body.up_mps - GRAVITY_MPS2 * dt_s, -TERMINAL_SPEED_MPS)
    return body._replace(
        east_m=body.east_m + body.east_mps * dt_s,
        north_m=body.north_m + body.north_mps * dt_s,
        up_m=max(body.ground_m, body.up_m + (body.up_mps + up_mps) / 2.0 * dt_s),
        up_mps=up_mps,
    )


def _horizontal_acceleration(body: Body, guidance: Guidance, limits: Limits, dt_s: float) -> tuple[float, float]:
    """Return (east, north) m/s^2 of this step; smooth where a jerk limit is set and no setpoint is streamed."""
    if guidance.velocity_mps is not None:
        change = _tracking_change(body, guidance, guidance.velocity_mps, limits)
    else:
        change = _approach_change(body, guidance, limits)
    size = math.hypot(*change)
    if size == 0.0:
        return 0.0, 0.0
    limit = limits.acceleration_mps2
    if limits.jerk_mps3 == math.inf or guidance.velocity_mps is not None:
        share = min(1.0 / dt_s, limit / size)
        return change[0] * share, change[1] * share
    wanted = min(limit, SPEED_GAIN_PER_S * size, math.sqrt(2.0 * JERK_SHARE * limits.jerk_mps3 * size)) / size
    east = change[0] * wanted - body.east_mps2
    north = change[1] * wanted - body.north_mps2
    turn = math.hypot(east, north)
    share = min(1.0, limits.jerk_mps3 * dt_s / turn) if turn > 0.0 else 0.0
    return body.east_mps2 + east * share, body.north_mps2 + north * share


def _approach_change(body: Body, guidance: Guidance, limits: Limits) -> tuple[float, float]:
    """Return the change of velocity (east, north) that would put the vehicle on its way to the point."""
    east_m, north_m = guidance.east_m - body.east_m, guidance.north_m - body.north_m
    distance_m = math.hypot(east_m, north_m)
    cruise = min(guidance.speed_mps, limits.max_speed_mps)
    braking, passing = BRAKING_SHARE * limits.acceleration_mps2, min(guidance.passing_mps, cruise)
    if limits.jerk_mps3 == math.inf:
        approach = approach_speed(distance_m, braking, passing)
    else:
        ahead_m = max(0.0, distance_m - JERK_LEAD_S * body.ground_speed_mps)
        approach = jerk_limited_approach(ahead_m, braking, JERK_SHARE * limits.jerk_mps3, passing)
    scale = min(cruise, approach) / distance_m if distance_m > 1e-9 else 0.0
    return east_m * scale - body.east_mps, north_m * scale - body.north_mps


def _tracking_change(
    body: Body, guidance: Guidance, velocity_mps: tuple[float, float, float], limits: Limits
) -> tuple[float, float]:
    """Return the change of velocity (east, north) that follows a moving point."""
    east = velocity_mps[0] + TRACKING_GAIN_PER_S * (guidance.east_m - body.east_m)
    north = velocity_mps[1] + TRACKING_GAIN_PER_S * (guidance.north_m - body.north_m)
    speed = math.hypot(east, north)
    share = min(1.0, limits.max_speed_mps / speed) if speed > 0.0 else 1.0
    return east * share - body.east_mps, north * share - body.north_mps


def _vertical_velocity(body: Body, guidance: Guidance, limits: Limits, dt_s: float) -> float:
    if guidance.landing:
        wanted = -limits.land_mps if body.up_m <= limits.land_slow_below_m else -limits.descend_mps
    else:
        error_m = guidance.up_m - body.up_m
        acceleration = BRAKING_SHARE * min(limits.climb_acceleration_mps2, limits.descend_acceleration_mps2)
        speed = approach_speed(abs(error_m), acceleration, guidance.passing_up_mps)
        wanted = speed if error_m >= 0.0 else -speed
        if guidance.velocity_mps is not None:
            wanted = guidance.velocity_mps[2] + TRACKING_GAIN_PER_S * error_m
        wanted = max(-limits.descend_mps, min(limits.climb_mps, wanted))
    change = wanted - body.up_mps
    up, down = limits.climb_acceleration_mps2, limits.descend_acceleration_mps2
    if guidance.passing_up_mps > 0.0:
        up, down = min(up, TURNING_UP_MPS2), min(down, TURNING_UP_MPS2)
    return body.up_mps + max(-down * dt_s, min(up * dt_s, change))


def _yaw(body: Body, guidance: Guidance, east_mps: float, north_mps: float, dt_s: float) -> float:
    wanted = guidance.yaw_rad
    if wanted is None:
        if math.hypot(east_mps, north_mps) < COURSE_SPEED_MPS:
            return body.yaw_rad
        wanted = math.atan2(east_mps, north_mps)
    turn = math.remainder(wanted - body.yaw_rad, math.tau)
    limit = YAW_RATE_RAD_S * dt_s
    return math.remainder(body.yaw_rad + max(-limit, min(limit, turn)), math.tau)
