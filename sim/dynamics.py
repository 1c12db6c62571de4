"""One vehicle's body in the air, moved by its guidance, with weather, a draining battery, and failures."""

import math
from typing import Protocol

from skyfolio.sim.airframe import ARMED_IDLE_W, GUST_SHARE, IDLE_W, MAX_AIRSPEED_MPS, Battery, flight_power_w
from skyfolio.sim.kinematics import Body, Guidance, fall, step
from skyfolio.sim.land import Land
from skyfolio.sim.parameter_store import ParameterStore
from skyfolio.sim.weather import Air

SOFT_TOUCHDOWN_MPS = 1.5
"""A frozen vehicle that sinks or slides no faster than this when it touches the ground has landed, not crashed."""


class Guide(Protocol):
    """Decides where to fly."""

    def guidance(self, body: Body, now_s: float) -> Guidance | None:
        """Return where to fly, or None to stay on the ground with the motors idling."""


class DynamicsHost(Protocol):
    """The vehicle around the body; an empty battery disarms it."""

    air: Air
    land: Land
    battery: Battery
    parameters: ParameterStore
    armed: bool

    @property
    def navigator(self) -> Guide:
        """Where the vehicle is to fly."""


class Dynamics:
    """The motion of one vehicle.

    `body` is where it truly is, `seen` what the autopilot steers by. `powered`: the motors can turn. `crashed`: it has
    hit the ground without power. `satellites`: the receiver has any. `landing`: the last guidance was to sink.
    """

    def __init__(self, host: DynamicsHost) -> None:
        self._host = host
        self.body = Body()
        self.powered = True
        self.crashed = False
        self.satellites = True
        self.landing = False

    @property
    def seen(self) -> Body:
        """The body as the position estimate has it; on the ground the height is exact."""
        error = self._host.air.error_m
        if error == (0.0, 0.0, 0.0):
            return self.body
        up_m = self.body.up_m if self.body.on_ground else self.body.up_m + error[2]
        return self.body._replace(east_m=self.body.east_m + error[0], north_m=self.body.north_m + error[1], up_m=up_m)

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly for `dt_s` seconds, to arrive at fleet time `now_s`."""
        host = self._host
        was_on_ground = self.body.on_ground
        host.air.step(now_s, dt_s, satellites=self.satellites)
        if host.battery.share <= 0.0 and host.armed:
            self.cut_power()
        if not self.powered:
            self.body = fall(self.body, dt_s)
        elif host.armed:
            self._fly(now_s, dt_s)
        self._meet_ground(was_on_ground=was_on_ground)
        self._drain(dt_s)

    def stand(self, now_s: float, for_s: float) -> None:
        """Let `for_s` seconds pass, until fleet time `now_s`, for a vehicle that stands disarmed: nothing moves."""
        self._host.air.step(now_s, for_s, satellites=self.satellites)
        self._drain(for_s)

    def cut_power(self) -> None:
        """Stop the motors, and disarm."""
        self.powered = self._host.armed = False

    def drift(self, dt_s: float) -> None:
        """Move for `dt_s` seconds while the autopilot does not run: the motors keep turning as they did."""
        body = self.body
        was_on_ground = body.on_ground
        if not self.powered:
            self.body = fall(body, dt_s)
        elif not was_on_ground:
            up_m = max(body.ground_m, body.up_m + body.up_mps * dt_s)
            east_m, north_m = body.east_m + body.east_mps * dt_s, body.north_m + body.north_mps * dt_s
            self.body = body._replace(east_m=east_m, north_m=north_m, up_m=up_m)
            if self.body.on_ground:
                soft = max(-body.up_mps, math.hypot(body.east_mps, body.north_mps)) <= SOFT_TOUCHDOWN_MPS
                self.body = self.body._replace(east_mps=0.0, north_mps=0.0, up_mps=0.0)
                self.crashed, self.powered = not soft, soft
        self._meet_ground(was_on_ground=was_on_ground)
        self._drain(dt_s)

    def _meet_ground(self, *, was_on_ground: bool) -> None:
        """Note the ground beneath; a vehicle that flies into it, and does not land, crashes."""
        body, land = self.body, self._host.land
        ground_m = land.up_m((body.east_m, body.north_m))
        if ground_m == body.ground_m:
            return
        stands = was_on_ground and body.on_ground
        if not stands and body.up_m > ground_m:
            self.body = body._replace(ground_m=ground_m)
            return
        still = {"east_mps": 0.0, "north_mps": 0.0, "up_mps": 0.0, "east_mps2": 0.0, "north_mps2": 0.0}
        self.body = body._replace(up_m=ground_m, ground_m=ground_m, **still)
        if not stands and not self.landing:
            self.crashed = True
            self.cut_power()

    def _fly(self, now_s: float, dt_s: float) -> None:
        host = self._host
        seen = self.seen
        guidance = host.navigator.guidance(seen, now_s)
        self.landing = guidance is not None and guidance.landing
        if guidance is None:
            return
        if seen is not self.body:
            guidance = self._as_steered(guidance)
        body = step(self.body, guidance, host.parameters.limits, dt_s)
        self.body = body if host.air.is_still or body.on_ground else self._blown(body, dt_s)

    def _as_steered(self, guidance: Guidance) -> Guidance:
        """Return the guidance in true places: moved by the error of the estimate."""
        east, north, up = self._host.air.error_m
        return guidance._replace(
            east_m=guidance.east_m - east, north_m=guidance.north_m - north, up_m=guidance.up_m - up
        )

    def _blown(self, body: Body, dt_s: float) -> Body:
        """Return the body moved by gusts, and carried off by a wind it cannot fly against."""
        air = self._host.air
        east, north = body.east_mps, body.north_mps
        wind_east, wind_north = air.wind_mps
        airspeed = math.hypot(east - wind_east, north - wind_north)
        if airspeed > MAX_AIRSPEED_MPS:
            share = MAX_AIRSPEED_MPS / airspeed
            east, north = wind_east + (east - wind_east) * share, wind_north + (north - wind_north) * share
        moved_east = (east - body.east_mps + GUST_SHARE * air.gust_mps[0]) * dt_s
        moved_north = (north - body.north_mps + GUST_SHARE * air.gust_mps[1]) * dt_s
        return body._replace(
            east_m=body.east_m + moved_east,
            north_m=body.north_m + moved_north,
            east_mps=east,
            north_mps=north,
        )

    def _drain(self, dt_s: float) -> None:
        host, body = self._host, self.body
        if not self.powered or body.up_m <= body.ground_m:
            power_w = ARMED_IDLE_W if host.armed else IDLE_W
        else:
            wind_east, wind_north = host.air.wind_mps
            power_w = flight_power_w(math.hypot(body.east_mps - wind_east, body.north_mps - wind_north), body.up_mps)
        host.battery.drain(power_w, dt_s, host.parameters.tuning.battery_capacity_mah)
