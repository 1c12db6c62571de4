"""Where each mode flies: hold, take-off, return, landing, a mission, or streamed setpoints."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from skyfolio.sim.geo import Place
from skyfolio.sim.hosts import Announcer, Equipment, VehicleState
from skyfolio.sim.kinematics import Body, Guidance, stopping_point
from skyfolio.sim.mission_state import Handover
from skyfolio.sim.modes import Mode
from skyfolio.sim.setpoints import Setpoint

_AT_HEIGHT_M = 0.5
"""A climb counts as done this close below its height, when the vehicle takes off or returns."""


class NavigatorHost(VehicleState, Equipment, Announcer, Protocol):
    """The vehicle that is guided."""

    def set_mode(self, mode: Mode) -> bool:
        """Change the mode; return whether it can be flown."""


class Navigator:
    """The guidance of one autopilot; `enter` is called at every change of mode.

    `return_point()` gives where a return ends, metres east and north. `setpoint`: the last one streamed.
    `cleared_for_takeoff`: a mission may leave the ground. `speed_mps`: a speed ordered for this mode, outside a
    mission; it is forgotten with the mode.
    """

    def __init__(self, host: NavigatorHost, return_point: Callable[[], Place]) -> None:
        self._host = host
        self._return_point = return_point
        self.cleared_for_takeoff = not host.traits.needs_clearance
        self.speed_mps: float | None = None
        self.setpoint: Setpoint | None = None
        self._hold: Guidance | None = None
        self._takeoff_up_m: float | None = None
        self._taking_off = False
        self._return: Guidance | None = None
        self._returning_in_mission = False
        self._over_home_s: float | None = None
        self._paused = False

    @property
    def taking_off(self) -> bool:
        """Whether a take-off is under way, by command or as the mission's item."""
        runner = self._host.runner
        return self._taking_off or (self._host.mode is Mode.MISSION and runner.taking_off)

    def armed(self) -> None:
        """Set whether a mission may take off now, as the vehicle has been armed."""
        tuning = self._host.parameters.tuning
        self.cleared_for_takeoff = not self._host.traits.needs_clearance or tuning.takeoff_without_throttle

    def start_mission(self) -> None:
        """Let the mission begin, or go on after it was over or halted (ArduCopter's MISSION_START in AUTO)."""
        self.cleared_for_takeoff = True
        if self._host.runner.over:
            self._host.runner.activate()

    def follow(self, setpoint: Setpoint) -> None:
        """Take a streamed setpoint; it counts in GUIDED, and opens the way there where one is needed for it."""
        if self._host.mode is Mode.GUIDED or self._host.traits.guided_needs_stream:
            self.setpoint = setpoint

    def thaw(self, frozen_s: float) -> None:
        """Leave out `frozen_s` seconds in which the autopilot hung and setpoints did not age."""
        if self.setpoint is not None:
            self.setpoint = replace(self.setpoint, at_s=self.setpoint.at_s + frozen_s)

    def enter(self, mode: Mode) -> None:
        """Start a mode afresh: from here, or from where the vehicle comes to rest."""
        self._hold = self._stop_here()
        self._takeoff_up_m = self._return = self._over_home_s = None
        self._returning_in_mission = self._paused = False
        self.speed_mps = None
        self._taking_off = mode is Mode.TAKEOFF
        self.setpoint = None if mode is not Mode.GUIDED else self.setpoint

    def settle(self) -> None:
        """Forget the place to hold: the vehicle stands on the ground."""
        self._hold = None
        self._taking_off = False

    def take_off(self, up_m: float | None) -> None:
        """Climb above this place to `up_m` metres above home (None: to the take-off parameter)."""
        self._taking_off = True
        self._takeoff_up_m = up_m

    def go_to(self, east_m: float | None, north_m: float | None, up_m: float | None, speed_mps: float) -> None:
        """Hold at a place and height (metres; None keeps the present one); a speed <= 0 means the cruise speed."""
        self.setpoint = None
        if self._hold is None:
            return
        here = self._hold
        self._hold = Guidance(
            here.east_m if east_m is None else east_m,
            here.north_m if north_m is None else north_m,
            here.up_m if up_m is None else up_m,
            speed_mps if speed_mps > 0.0 else here.speed_mps,
        )

    def pause(self, *, paused: bool) -> None:
        """Stop where the vehicle is without leaving the mode, or go on."""
        self._paused = paused
        if paused:
            self._hold = self._stop_here()

    def guidance(self, body: Body, now_s: float) -> Guidance | None:
        """Return where to fly, or None to stay on the ground with the motors idling."""
        mode = self._host.mode
        if self._paused and not body.on_ground:
            return self._hold
        if mode is Mode.MISSION:
            return self._mission(body, now_s)
        if self._taking_off:
            return self._climb(body)
        if body.on_ground:
            return None
        if mode is Mode.GUIDED and self.setpoint is not None:
            return self._to_setpoint(body, now_s, self.setpoint)
        if self._hold is None:
            self._hold = self._stop_here()
        hold = self._hold or self._here(body)
        if self.speed_mps is not None:
            hold = hold._replace(speed_mps=self.speed_mps)
        if mode is Mode.LAND:
            return hold._replace(landing=True)
        return self._home(body, now_s) if mode is Mode.RTL else hold

    def _mission(self, body: Body, now_s: float) -> Guidance | None:
        host = self._host
        runner = host.runner
        if body.on_ground and (runner.complete or not self.cleared_for_takeoff):
            return None
        if self._returning_in_mission:
            return self._home(body, now_s)
        result = runner.fly(body, now_s)
        if isinstance(result, Guidance):
            self._hold = None
            return result
        return self._after_mission(body, now_s, result)

    def _after_mission(self, body: Body, now_s: float, result: Handover) -> Guidance | None:
        host = self._host
        if host.traits.leaves_mission_at_end:
            if result is Handover.FINISHED:
                host.send_text("Mission finished, loitering\t")
            if result is not Handover.LANDED:
                host.set_mode(Mode.HOLD)
            if result is Handover.RETURN:
                host.set_mode(Mode.RTL)
            return None if body.on_ground else self.guidance(body, now_s)
        if self._hold is None:
            self._hold = self._stop_here()
        if result is Handover.RETURN:
            self._returning_in_mission = True
            return self._home(body, now_s)
        return self._hold

    def _climb(self, body: Body) -> Guidance:
        host = self._host
        if self._hold is None:
            self._hold = self._here(body)
        if self._takeoff_up_m is None:
            self._takeoff_up_m = host.parameters.tuning.takeoff_alt_m
        up_m = max(self._takeoff_up_m, self._hold.up_m)
        guidance = self._hold._replace(up_m=up_m)
        if abs(up_m - body.up_m) <= host.parameters.tuning.altitude_radius_m / 2.0:
            self._taking_off = False
            if host.mode is Mode.TAKEOFF:
                host.runner.finished = True
                host.set_mode(Mode.HOLD)
            self._hold = guidance
        return guidance

    def _home(self, body: Body, now_s: float) -> Guidance:
        """Climb, fly home (or to the nearest rally point), wait, land."""
        host = self._host
        tuning = host.parameters.tuning
        way = self._return
        if way is None:
            goal = self._return_point()
            climb = body.distance_to(*goal) > tuning.return_cone_m
            up_m = max(body.up_m, tuning.return_alt_m if climb else 0.0)
            way = self._return = Guidance(*goal, up_m, tuning.limits.cruise_speed_mps)
            if host.traits.restores_mode:
                amsl_m, above_m = math.ceil(host.spec.home_alt_m + up_m), math.ceil(up_m)
                host.send_text(f"RTL: start return at {amsl_m} m ({above_m} m above destination)\t")
        way = way._replace(speed_mps=self.speed_mps or tuning.limits.cruise_speed_mps)
        if body.distance_to(way.east_m, way.north_m) <= tuning.acceptance_radius_m and self._over_home_s is None:
            self._over_home_s = now_s
            if host.traits.restores_mode:
                host.send_text("RTL: land at destination\t")
        if self._over_home_s is not None:
            landing = now_s - self._over_home_s >= tuning.return_loiter_s
            return way._replace(up_m=0.0 if landing else way.up_m, landing=landing)
        if way.up_m - body.up_m > tuning.altitude_radius_m and self._hold is not None:
            return self._hold._replace(up_m=way.up_m)
        return way

    def _to_setpoint(self, body: Body, now_s: float, setpoint: Setpoint) -> Guidance | None:
        limits = self._host.parameters.limits
        moving = self._host.traits.setpoints_move
        stale = now_s - setpoint.at_s > self._host.parameters.tuning.setpoint_timeout_s
        return setpoint.guidance(body, now_s, limits.cruise_speed_mps, moving=moving, stale=stale)

    def _stop_here(self) -> Guidance | None:
        """Return where the vehicle comes to rest when it brakes now; None on the ground."""
        body = self._host.seen
        if body.on_ground:
            return None
        east_m, north_m = stopping_point(body, self._host.parameters.limits)
        return self._here(body)._replace(east_m=east_m, north_m=north_m)

    def _here(self, body: Body) -> Guidance:
        limits = self._host.parameters.limits
        return Guidance(body.east_m, body.north_m, body.up_m, max(limits.cruise_speed_mps, body.ground_speed_mps))
