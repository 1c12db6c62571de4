"""One vehicle's body in the air: steps it by its guidance, with weather, a draining battery, and failures."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from skyfolio.sim.airframe import ARMED_IDLE_W, GUST_SHARE, IDLE_W, MAX_AIRSPEED_MPS, flight_power_w
from skyfolio.sim.kinematics import Body, Guidance, fall, step

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

SOFT_TOUCHDOWN_MPS = 1.5
"""A frozen vehicle that sinks or slides no faster than this when it touches the ground has landed, not crashed."""


class Dynamics:
    """`body` is the truth, `seen` what the autopilot steers by. `powered`: the motors can turn."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self.body = Body()
        self.powered = True
        self.crashed = False
        self.satellites = True
        self.landing = False

    @property
    def seen(self) -> Body:
        """The body as the position estimate has it; on the ground the height is known."""
        error = self._autopilot.air.error_m
        if error == (0.0, 0.0, 0.0):
            return self.body
        up_m = self.body.up_m if self.body.on_ground else self.body.up_m + error[2]
        return replace(self.body, east_m=self.body.east_m + error[0], north_m=self.body.north_m + error[1], up_m=up_m)

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly `dt_s`, to arrive at fleet time `now_s`."""
        autopilot = self._autopilot
        autopilot.air.step(dt_s, satellites=self.satellites)
        if autopilot.battery.share <= 0.0 and autopilot.armed:
            self.powered = autopilot.armed = False
        if not self.powered:
            self.body = fall(self.body, dt_s)
        elif autopilot.armed:
            self._fly(now_s, dt_s)
        self._drain(dt_s)

    def drift(self, dt_s: float) -> None:
        """Fly on as before while the autopilot is frozen: the motors keep turning as they did."""
        body = self.body
        if not self.powered:
            self.body = fall(body, dt_s)
        elif not body.on_ground:
            up_m = max(0.0, body.up_m + body.up_mps * dt_s)
            east_m, north_m = body.east_m + body.east_mps * dt_s, body.north_m + body.north_mps * dt_s
            self.body = replace(body, east_m=east_m, north_m=north_m, up_m=up_m)
            if self.body.on_ground:
                soft = max(-body.up_mps, math.hypot(body.east_mps, body.north_mps)) <= SOFT_TOUCHDOWN_MPS
                self.body = replace(self.body, east_mps=0.0, north_mps=0.0, up_mps=0.0)
                self.crashed, self.powered = not soft, soft
        self._drain(dt_s)

    def _fly(self, now_s: float, dt_s: float) -> None:
        autopilot = self._autopilot
        seen = self.seen
        guidance = autopilot.navigator.guidance(seen, now_s)
        self.landing = guidance is not None and guidance.landing
        if guidance is None:
            return
        if seen is not self.body:
            guidance = self._as_steered(guidance)
        body = step(self.body, guidance, autopilot.parameters.limits, dt_s)
        self.body = body if autopilot.air.is_still or body.on_ground else self._blown(body, dt_s)

    def _as_steered(self, guidance: Guidance) -> Guidance:
        """Return the guidance as the truth feels it: moved by what the estimate is wrong by."""
        east, north, up = self._autopilot.air.error_m
        return replace(
            guidance, east_m=guidance.east_m - east, north_m=guidance.north_m - north, up_m=guidance.up_m - up
        )

    def _blown(self, body: Body, dt_s: float) -> Body:
        """Return the body moved by gusts, and carried off by a wind it cannot fly against."""
        air = self._autopilot.air
        east, north = body.east_mps, body.north_mps
        wind_east, wind_north = air.wind_mps
        airspeed = math.hypot(east - wind_east, north - wind_north)
        if airspeed > MAX_AIRSPEED_MPS:
            share = MAX_AIRSPEED_MPS / airspeed
            east, north = wind_east + (east - wind_east) * share, wind_north + (north - wind_north) * share
        moved_east = (east - body.east_mps + GUST_SHARE * air.gust_mps[0]) * dt_s
        moved_north = (north - body.north_mps + GUST_SHARE * air.gust_mps[1]) * dt_s
        return replace(
            body,
            east_m=body.east_m + moved_east,
            north_m=body.north_m + moved_north,
            east_mps=east,
            north_mps=north,
        )

    def _drain(self, dt_s: float) -> None:
        autopilot, body = self._autopilot, self.body
        if body.on_ground or not self.powered:
            power_w = ARMED_IDLE_W if autopilot.armed else IDLE_W
        else:
            wind_east, wind_north = autopilot.air.wind_mps
            power_w = flight_power_w(math.hypot(body.east_mps - wind_east, body.north_mps - wind_north), body.up_mps)
        autopilot.battery.drain(power_w, dt_s, autopilot.parameters.tuning.battery_capacity_mah)
