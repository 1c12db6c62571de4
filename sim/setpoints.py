"""Streamed setpoints: SET_POSITION_TARGET_LOCAL_NED and SET_POSITION_TARGET_GLOBAL_INT."""

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.kinematics import Body, Guidance
from skyfolio.sim.missions import ABSOLUTE_FRAMES, RELATIVE_FRAMES

MESSAGES = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"})
_NO_POSITION = 0b0000_0000_0111
_NO_VELOCITY = 0b0000_0011_1000
_NO_YAW = 0b0100_0000_0000
_OFFSET_FRAMES = (dialect.MAV_FRAME_LOCAL_OFFSET_NED, dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_OFFSET_NED)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A place (metres east, north, up of the spawn point), a velocity (m/s, same axes), or both, sent at `at_s`."""

    at_s: float
    place_m: tuple[float, float, float] | None
    velocity_mps: tuple[float, float, float] | None
    yaw_rad: float | None

    def guidance(self, body: Body, now_s: float, cruise_mps: float, *, moving: bool, stale: bool) -> Guidance:
        """Return how to follow; `moving`: the place goes on with its velocity; `stale`: the velocity is dropped."""
        velocity = None if stale else self.velocity_mps
        place = self.place_m
        if place is None:
            place = (body.east_m, body.north_m, body.up_m)
            if velocity is None:
                velocity = (0.0, 0.0, 0.0)
        elif moving and self.velocity_mps is not None:
            age_s = 0.0 if stale else now_s - self.at_s
            place = tuple(p + v * age_s for p, v in zip(place, self.velocity_mps, strict=True))  # type: ignore[assignment]
        return Guidance(*place, cruise_mps, velocity_mps=velocity, yaw_rad=self.yaw_rad)


def setpoint_of(message: Any, frame: LocalFrame, home_alt_m: float, body: Body, now_s: float) -> Setpoint | None:
    """Return the setpoint in a message, or None if it cannot be flown (frame, mask, or numbers).

    `body` is where the vehicle believes that it is, for frames relative to it; `now_s` is fleet time.
    """
    mask = message.type_mask
    velocity = None if mask & _NO_VELOCITY else (message.vy, message.vx, -message.vz)
    yaw = None if mask & _NO_YAW else message.yaw
    if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
        place = _local(message, body)
    else:
        place = _global(message, frame, home_alt_m)
    if mask & _NO_POSITION:
        place = None
    elif place is None:
        return None
    if not all(math.isfinite(value) for value in (*(place or ()), *(velocity or ()), yaw or 0.0)):
        return None
    return Setpoint(now_s, place, velocity, yaw) if place or velocity else None


def _local(message: Any, body: Body) -> tuple[float, float, float] | None:
    if message.coordinate_frame == dialect.MAV_FRAME_LOCAL_NED:
        return message.y, message.x, -message.z
    if message.coordinate_frame not in _OFFSET_FRAMES:
        return None
    north, east = message.x, message.y
    if message.coordinate_frame != dialect.MAV_FRAME_LOCAL_OFFSET_NED:
        ahead, right = message.x, message.y
        north = ahead * math.cos(body.yaw_rad) - right * math.sin(body.yaw_rad)
        east = ahead * math.sin(body.yaw_rad) + right * math.cos(body.yaw_rad)
    return body.east_m + east, body.north_m + north, body.up_m - message.z


def _global(message: Any, frame: LocalFrame, home_alt_m: float) -> tuple[float, float, float] | None:
    if message.coordinate_frame in RELATIVE_FRAMES:
        up_m = message.alt
    elif message.coordinate_frame in ABSOLUTE_FRAMES:
        up_m = message.alt - home_alt_m
    else:
        return None
    if abs(message.lat_int) > 90 * 10**7 or abs(message.lon_int) > 180 * 10**7:
        return None
    return (*frame.to_local(message.lat_int / 1e7, message.lon_int / 1e7), up_m)
