"""The flying of a mission: where to go for the current item, how fast, and when it is done.

Pure: it takes the body and fleet time, and returns guidance. Here is what both flavours share, flown as PX4 does: a
waypoint counts as reached within its acceptance radius (param2, else NAV_ACC_RAD) and NAV_MC_ALT_RAD of altitude; its
hold (param1) starts then. Waypoints without a hold are flown through, slower the sharper the corner. Altitude is flown
apart from the way over ground, as fast as limits allow, and passed at speed where the altitude after it is another one:
a waypoint that was passed too high or too low is flown back to. A mission that is entered in the air, lower than its
waypoint by more than NAV_MC_ALT_RAD, begins with a climb on the spot.
`sim.ardupilot_runner` has what ArduCopter does differently.
"""

import math
from collections.abc import Callable
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import LocalFrame, Place, corner_speed, distance_from_segment
from skyfolio.sim.kinematics import Body, Guidance, stopping_point
from skyfolio.sim.mission_cursor import MissionCursor
from skyfolio.sim.mission_geometry import changed_speed
from skyfolio.sim.mission_state import NOTHING_REACHED, Handover, Target
from skyfolio.sim.missions import Mission, MissionItem
from skyfolio.sim.onboard_clock import DAY_S
from skyfolio.sim.parameter_store import ParameterStore

_HOVERS = (dialect.MAV_CMD_NAV_WAYPOINT, dialect.MAV_CMD_NAV_LOITER_TIME)
"""Items whose param1 is a time to stay."""
_SAME_M = 0.001
"""Altitudes of two waypoints that are no different."""


class MissionRunner(MissionCursor):
    """The cursor in a mission, and the flying of it.

    `on_reached(seq)` is called for every item that is done, `on_speed(speed_mps)` for every speed change on the way.
    `utc(now_s)` gives the seconds since midnight UTC at a moment of fleet time (NAV_DELAY), `send_text` sends a
    STATUSTEXT.
    """

    look_ahead = 4
    """How many corners ahead are considered for the speed at the next one."""

    def __init__(
        self,
        frame: LocalFrame,
        home_alt_m: float,
        parameters: ParameterStore,
        on_reached: Callable[[int], None],
        *,
        utc: Callable[[float], float] = lambda now_s: now_s % DAY_S,
        send_text: Callable[[str], None] = lambda _: None,
        on_speed: Callable[[float], None] = lambda _: None,
    ) -> None:
        super().__init__(frame, parameters)
        self._home_alt_m = home_alt_m
        self._on_reached = on_reached
        self._utc = utc
        self._send_text = send_text
        self._on_speed = on_speed
        self._target: Target | None = None
        self._holding_since_s: float | None = None
        self._climb_first = self._is_entered = False
        self._delay_until_s: float | None = None
        self._was: Place = (0.0, 0.0)

    def leave(self) -> None:
        """Leave the mission mode, and forget the speed that was ordered in it."""
        self.speed_mps = None

    def rewind(self) -> None:
        """Go back to the beginning where disarming does that; PX4 keeps its place."""

    def forget_flight(self) -> None:
        """Start afresh with what is stored: the autopilot has booted."""
        self.rewind()
        self.finished = False
        self.reached = NOTHING_REACHED

    def edit(self, mission: Mission, *, running: bool) -> bool:
        """Fly on by a mission that is being written in place (ArduPilot); return whether the current leg restarts."""
        del mission, running
        return False

    def load(self, mission: Mission, *, on_ground: bool) -> None:
        """Begin a new mission at its item with current = 1; without one, at the old index as far as it exists."""
        marked = mission.marked_current
        index = 0 if on_ground or self.complete else min(self.index, max(len(mission) - 1, 0))
        self.mission = mission
        self.started = self.finished = False
        if on_ground:
            self.speed_mps = None
        self.jump(index if marked is None else marked)

    def jump(self, seq: int) -> None:
        """Make an item current and fly it afresh."""
        self.index = seq
        self.complete = False
        self.reached = NOTHING_REACHED
        self._forget()

    def activate(self) -> None:
        """Enter the mission: go on with the current item, or from the start if the mission was complete.

        The last speed change before that item counts again.
        """
        if self.complete:
            self.jump(0)
        self.started, self.finished, self._is_entered = True, False, True
        self.speed_mps = None
        for item in self.mission.items[: self.index]:
            if item.command == dialect.MAV_CMD_DO_CHANGE_SPEED:
                self.speed_mps = changed_speed(self.speed_mps, item)
        self._forget()

    def fly(self, body: Body, now_s: float) -> Guidance | Handover:
        """Return where to go now; items that are done are passed on the way."""
        if not self._has_item():
            return Handover.FINISHED
        for _ in range(len(self.mission) + 2):
            result = self._fly_item(body, now_s)
            if result is not None:
                self._was = (body.east_m, body.north_m)
                return result
            self._on_reached(self.item.seq)
            command = self.item.command
            if not self._advance():
                self.complete = self.finished = True
                if command == dialect.MAV_CMD_NAV_LAND:
                    self._report_landed()
                return Handover.LANDED if command == dialect.MAV_CMD_NAV_LAND else Handover.FINISHED
            self._forget()
        return Handover.FINISHED

    def _report_landed(self) -> None:
        """Send that the mission ended on the ground."""
        self._send_text("Mission finished, landed\t")

    def _has_item(self) -> bool:
        return bool(self.mission.items)

    def _advance(self) -> bool:
        """Go on to the next item; return False after the last one."""
        if self.index + 1 >= len(self.mission):
            return False
        self.index += 1
        return True

    def _fly_item(self, body: Body, now_s: float) -> Guidance | Handover | None:
        """Return guidance for the current item, or None once it is done."""
        item = self.item
        if item.command == dialect.MAV_CMD_DO_CHANGE_SPEED:
            self.speed_mps = changed_speed(self.speed_mps, item)
            if self.speed_mps is not None:
                self._on_speed(self.speed_mps)
            return None
        if item.command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self._on_reached(self.index)
            self.complete = self.finished = True
            return Handover.RETURN
        if item.command == dialect.MAV_CMD_NAV_DELAY:
            return self._delay(body, now_s)
        target = self._target or self._begin(body)
        if self._climb_first:
            if not self._has_climbed(body, target):
                return Guidance(*self._was, up_m=target.up_m, speed_mps=self.cruise_mps)
            self._climb_first = False
        if item.command == dialect.MAV_CMD_NAV_LAND:
            return self._land(body, target)
        if self._is_done(body, target, now_s):
            return None
        return self._towards(body, target)

    def _begin(self, body: Body) -> Target:
        """Set the target of the current item, seen from where the vehicle is now."""
        item = self.item
        self._was = (body.east_m, body.north_m)
        east_m, north_m = self._place(item) or self._was
        up_m = body.up_m if item.command == dialect.MAV_CMD_NAV_LAND else item.relative_alt_m(self._home_alt_m)
        if body.on_ground and item.command != dialect.MAV_CMD_NAV_LAND:
            up_m = max(up_m, self._parameters.tuning.takeoff_alt_m)
        self._climb_first = item.command != dialect.MAV_CMD_NAV_LAND and (
            body.on_ground or (self._is_entered and up_m - body.up_m > self._parameters.tuning.altitude_radius_m)
        )
        self._is_entered = False
        place = (east_m, north_m)
        passing = self.passing_speed(self.index, self._was, place, self.speed_mps, self.look_ahead)
        up_mps = self._passing_up_mps(body, place, up_m) if passing > 0.0 else 0.0
        self._target = Target(*place, up_m, self._radius(item), passing, self._yaw(item), up_mps)
        return self._target

    def _passing_up_mps(self, body: Body, place: Place, up_m: float) -> float:
        """Return how fast the altitude of the current item is passed: sqrt(a r tan(angle between the legs / 2)).

        The angle is that between altitudes over distances from home: PX4 takes it so (`PositionSmoothing`, 1.18).
        """
        after = next((item for item in self.mission.items[self.index + 1 :] if item.is_nav), None)
        goal = None if after is None else self._place(after)
        if after is None or goal is None:
            return 0.0
        limits, radius_m = self._parameters.limits, self._parameters.tuning.altitude_radius_m
        next_up_m = after.relative_alt_m(self._home_alt_m)
        if abs(next_up_m - up_m) <= _SAME_M:
            return 0.0
        start, corner = (math.hypot(body.east_m, body.north_m), body.up_m), (math.hypot(*place), up_m)
        turn = corner_speed(start, corner, (math.hypot(*goal), next_up_m), limits.climb_acceleration_mps2, radius_m)
        return min(turn, limits.climb_mps if up_m >= body.up_m else limits.descend_mps)

    def _delay(self, body: Body, now_s: float) -> Guidance | None:
        """Stay for a time (param1) or until a time of day (UTC hour, minute, second), tomorrow if it has passed."""
        item = self.item
        if self._delay_until_s is None:
            wait_s = item.param1
            if wait_s < 0.0:
                of_day = sum(max(part, 0.0) * unit for part, unit in zip(_time_of(item), (3600, 60, 1), strict=True))
                wait_s = (of_day - self._utc(now_s)) % DAY_S
            self._send_text(f"Delaying {wait_s:.0f} sec")
            self._delay_until_s = now_s + wait_s
            self._target = Target(*stopping_point(body, self._parameters.limits), body.up_m, 0.0, 0.0)
        if now_s >= self._delay_until_s or self._target is None:
            return None
        return Guidance(self._target.east_m, self._target.north_m, self._target.up_m, self.cruise_mps)

    def _has_climbed(self, body: Body, target: Target) -> bool:
        return target.up_m - body.up_m <= self._parameters.tuning.altitude_radius_m

    def _land(self, body: Body, target: Target) -> Guidance | None:
        if body.on_ground:
            return None
        if body.distance_to(target.east_m, target.north_m) <= target.radius_m or self._holding_since_s is not None:
            self._holding_since_s = 0.0
            return Guidance(target.east_m, target.north_m, 0.0, self.cruise_mps, landing=True)
        return Guidance(target.east_m, target.north_m, target.up_m, self.cruise_mps)

    def _is_done(self, body: Body, target: Target, now_s: float) -> bool:
        if self._holding_since_s is None:
            near = distance_from_segment(self._was, (body.east_m, body.north_m), (target.east_m, target.north_m))
            if near > target.radius_m:
                return False
            if abs(target.up_m - body.up_m) > self._parameters.tuning.altitude_radius_m:
                self._target = replace(target, passing_mps=0.0)  # it has missed its waypoint, and comes back to it
                return False
            self._holding_since_s = now_s
        if self.item.command == dialect.MAV_CMD_NAV_LOITER_UNLIM:
            return False
        hold_s = self.item.param1 if self.item.command in _HOVERS else 0.0
        return now_s - self._holding_since_s >= hold_s

    def _towards(self, body: Body, target: Target) -> Guidance:
        del body
        return Guidance(
            target.east_m,
            target.north_m,
            target.up_m,
            self.cruise_mps,
            target.passing_mps,
            yaw_rad=target.yaw_rad,
            passing_up_mps=target.passing_up_mps,
        )

    def _yaw(self, item: MissionItem) -> float | None:
        """Return the heading of a waypoint in radians (param4, degrees); None (NaN) leaves it along the course."""
        wanted = item.command == dialect.MAV_CMD_NAV_WAYPOINT and math.isfinite(item.param4)
        return math.radians(item.param4) if wanted else None

    def _forget(self) -> None:
        self._target = self._delay_until_s = None
        self._holding_since_s = None


def _time_of(item: MissionItem) -> tuple[float, float, float]:
    """Return hour, minute and second of a NAV_DELAY; NaN, for one that is not given, counts as 0."""
    parts = [part if math.isfinite(part) else 0.0 for part in (item.param2, item.param3, item.param4)]
    return parts[0], parts[1], parts[2]
