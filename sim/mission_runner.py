"""Flies a mission: which item is current, where to go for it, how fast, and when it is done.

Pure: fed with the body and fleet time, it returns guidance. A waypoint counts as reached within its acceptance radius
(param2, else NAV_ACC_RAD) and NAV_MC_ALT_RAD of altitude; its hold (param1) starts then. Waypoints without a hold are
flown through, slower the sharper the corner.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.geo import LocalFrame
from sim.missions import Mission, MissionItem
from sim.parameters import ParameterStore
from sim.vehicle import BRAKING_SHARE, Body, Guidance

Place = tuple[float, float]
"""Metres east and north of the spawn point."""

LOOK_AHEAD = 4
"""How many corners ahead are considered for the speed at the next one."""


class Handover(Enum):
    """The runner has nothing more to fly; somebody else takes over."""

    FINISHED = auto()
    LANDED = auto()
    RETURN = auto()


@dataclass(frozen=True, slots=True)
class _Target:
    east_m: float
    north_m: float
    up_m: float
    radius_m: float
    passing_mps: float


class MissionRunner:
    """The cursor in a mission and the flying of it; `on_reached(seq)` is called for every item that is done."""

    def __init__(
        self, frame: LocalFrame, home_alt_m: float, parameters: ParameterStore, on_reached: Callable[[int], None]
    ) -> None:
        self.mission = Mission()
        self.index = 0
        self.complete = False
        self.started = False
        self.speed_mps: float | None = None
        self._frame = frame
        self._home_alt_m = home_alt_m
        self._parameters = parameters
        self._on_reached = on_reached
        self._target: _Target | None = None
        self._holding_since_s: float | None = None
        self._climb_first = False
        self._was: Place = (0.0, 0.0)

    @property
    def item(self) -> MissionItem:
        """The item being flown."""
        return self.mission.items[self.index]

    @property
    def cruise_mps(self) -> float:
        """The ground speed in force: the last speed change, else MPC_XY_CRUISE."""
        return self._cruise(self.speed_mps)

    def load(self, mission: Mission, *, on_ground: bool) -> None:
        """Take a new mission from its item with current = 1; without one, from the old index as far as it exists."""
        marked = mission.marked_current
        kept = 0 if on_ground or self.complete else min(self.index, max(len(mission) - 1, 0))
        self.mission = mission
        self.started = False
        if on_ground:
            self.speed_mps = None
        self.jump(kept if marked is None else marked)

    def jump(self, seq: int) -> None:
        """Make an item current and fly it afresh."""
        self.index = seq
        self.complete = False
        self._forget()

    def activate(self) -> None:
        """Enter the mission: go on with the current item, or from the start if the mission was complete."""
        if self.complete:
            self.jump(0)
        self.started = True
        self._forget()

    def fly(self, body: Body, now_s: float) -> Guidance | Handover:
        """Return where to go now; items that are done are passed on the way."""
        if not self.mission.items:
            return Handover.FINISHED
        for _ in range(len(self.mission) + 1):
            result = self._fly_item(body, now_s)
            if result is not None:
                self._was = (body.east_m, body.north_m)
                return result
            self._on_reached(self.index)
            if self.index + 1 >= len(self.mission):
                self.complete = True
                return Handover.LANDED if self.item.command == dialect.MAV_CMD_NAV_LAND else Handover.FINISHED
            self.index += 1
            self._forget()
        return Handover.FINISHED

    def _fly_item(self, body: Body, now_s: float) -> Guidance | Handover | None:
        """Return guidance for the current item, or None once it is done."""
        item = self.item
        if item.command == dialect.MAV_CMD_DO_CHANGE_SPEED:
            self.speed_mps = _changed(self.speed_mps, item)
            return None
        if item.command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self._on_reached(self.index)
            self.complete = True
            return Handover.RETURN
        if self._target is None:
            self._begin(body)
        target = self._target
        assert target is not None  # noqa: S101
        if self._climb_first:
            if not self._has_climbed(body, target):
                return Guidance(*self._was, up_m=target.up_m, speed_mps=self.cruise_mps)
            self._climb_first = False
        if item.command == dialect.MAV_CMD_NAV_LAND:
            return self._land(body, target)
        if self._is_done(body, target, now_s):
            return None
        return self._towards(body, target)

    def _begin(self, body: Body) -> None:
        """Fix the target of the current item, seen from where the vehicle is now."""
        item = self.item
        self._was = (body.east_m, body.north_m)
        east_m, north_m = self._place(item) or self._was
        up_m = body.up_m if item.command == dialect.MAV_CMD_NAV_LAND else item.relative_alt_m(self._home_alt_m)
        if body.on_ground and item.command != dialect.MAV_CMD_NAV_LAND:
            up_m = max(up_m, self._parameters["MIS_TAKEOFF_ALT"])
        self._climb_first = body.on_ground and item.command != dialect.MAV_CMD_NAV_LAND
        passing = self._passing_speed(self.index, self._was, (east_m, north_m), self.speed_mps, LOOK_AHEAD)
        self._target = _Target(east_m, north_m, up_m, self._radius(item), passing)

    def _has_climbed(self, body: Body, target: _Target) -> bool:
        return target.up_m - body.up_m <= self._parameters["NAV_MC_ALT_RAD"]

    def _land(self, body: Body, target: _Target) -> Guidance | None:
        if body.on_ground:
            return None
        if body.distance_to(target.east_m, target.north_m) <= target.radius_m or self._holding_since_s is not None:
            self._holding_since_s = 0.0
            return Guidance(target.east_m, target.north_m, 0.0, self.cruise_mps, landing=True)
        return Guidance(target.east_m, target.north_m, target.up_m, self.cruise_mps)

    def _is_done(self, body: Body, target: _Target, now_s: float) -> bool:
        if self._holding_since_s is None:
            near = _distance_from_segment(self._was, (body.east_m, body.north_m), (target.east_m, target.north_m))
            if near > target.radius_m or abs(target.up_m - body.up_m) > self._parameters["NAV_MC_ALT_RAD"]:
                return False
            self._holding_since_s = now_s
        if self.item.command == dialect.MAV_CMD_NAV_LOITER_UNLIM:
            return False
        hold_s = self.item.param1 if self.item.command == dialect.MAV_CMD_NAV_WAYPOINT else 0.0
        return now_s - self._holding_since_s >= hold_s

    def _towards(self, body: Body, target: _Target) -> Guidance:
        passing = target.passing_mps
        if passing > 0.0:
            limits = self._parameters.limits
            rise_m = target.up_m - body.up_m
            vertical_s = rise_m / limits.climb_mps if rise_m > 0.0 else -rise_m / limits.descend_mps
            late = vertical_s > body.distance_to(target.east_m, target.north_m) / max(self.cruise_mps, 0.1)
            if late and abs(rise_m) > self._parameters["NAV_MC_ALT_RAD"]:
                passing = 0.0
        return Guidance(target.east_m, target.north_m, target.up_m, self.cruise_mps, passing)

    def _passing_speed(self, index: int, start: Place, corner: Place, speed: float | None, depth: int) -> float:
        """Return the speed at the corner of item `index`, reached from `start`, that the legs after it allow."""
        item = self.mission.items[index]
        flown_through = item.command == dialect.MAV_CMD_NAV_WAYPOINT and item.param1 <= 0.0
        if depth == 0 or not flown_through:
            return 0.0
        for following in range(index + 1, len(self.mission)):
            after = self.mission.items[following]
            if not after.is_nav:
                speed = _changed(speed, after)
                continue
            goal = self._place(after)
            if goal is None:
                return 0.0
            acceleration = BRAKING_SHARE * self._parameters.limits.acceleration_mps2
            beyond = self._passing_speed(following, corner, goal, speed, depth - 1)
            leg = math.hypot(beyond, math.sqrt(2.0 * acceleration * math.dist(corner, goal)))
            turn = _corner_speed(start, corner, goal, acceleration, self._radius(item))
            return min(leg, turn, self._cruise(speed))
        return 0.0

    def _place(self, item: MissionItem) -> Place | None:
        return self._frame.to_local(item.x / 1e7, item.y / 1e7) if item.has_place else None

    def _radius(self, item: MissionItem) -> float:
        own = item.command == dialect.MAV_CMD_NAV_WAYPOINT and item.param2 > 0.0
        return item.param2 if own else self._parameters["NAV_ACC_RAD"]

    def _cruise(self, speed_mps: float | None) -> float:
        limits = self._parameters.limits
        return min(limits.cruise_speed_mps if speed_mps is None else speed_mps, limits.max_speed_mps)

    def _forget(self) -> None:
        self._target = None
        self._holding_since_s = None


def _changed(speed_mps: float | None, item: MissionItem) -> float | None:
    """Return the speed in force after DO_CHANGE_SPEED: -1 keeps it, -2 goes back to the default."""
    if item.param2 > 0.0:
        return item.param2
    return None if item.param2 == -2.0 else speed_mps


def _corner_speed(
    start: Place,
    corner: Place,
    goal: Place,
    acceleration: float,
    radius: float,
) -> float:
    """Return the speed at which the turn fits in the acceptance radius: sqrt(a r tan(angle between the legs / 2))."""
    before, after = math.dist(start, corner), math.dist(corner, goal)
    if before < 0.1 or after < 0.1:
        return math.inf if before < 0.1 else 0.0
    back = (start[0] - corner[0]) * (goal[0] - corner[0]) + (start[1] - corner[1]) * (goal[1] - corner[1])
    angle = math.acos(max(-1.0, min(1.0, back / (before * after))))
    return math.sqrt(acceleration * radius * math.tan(angle / 2.0)) if angle < math.pi - 1e-6 else math.inf


def _distance_from_segment(a: Place, b: Place, point: Place) -> float:
    """Return the distance of `point` from the path a-b flown since the last look."""
    along = (b[0] - a[0], b[1] - a[1])
    length2 = along[0] ** 2 + along[1] ** 2
    share = 1.0
    if length2 > 0.0:
        share = max(0.0, min(1.0, ((point[0] - a[0]) * along[0] + (point[1] - a[1]) * along[1]) / length2))
    return math.hypot(a[0] + share * along[0] - point[0], a[1] + share * along[1] - point[1])
