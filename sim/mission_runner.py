"""Flies a mission: which item is current, where to go for it, how fast, and when it is done.

Pure: fed with the body and fleet time, it returns guidance. Here is what both flavours share, flown as PX4 does: a
waypoint counts as reached within its acceptance radius (param2, else NAV_ACC_RAD) and NAV_MC_ALT_RAD of altitude; its
hold (param1) starts then. Waypoints without a hold are flown through, slower the sharper the corner.
`sim.ardupilot_runner` has what ArduCopter does differently.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.geo import LocalFrame, Place, distance_from_segment
from sim.mission_geometry import MissionGeometry, changed_speed
from sim.missions import Mission, MissionItem
from sim.parameters import ParameterStore
from sim.vehicle import Body, Guidance, stopping_point

DAY_S = 86_400.0
_HOVERS = (dialect.MAV_CMD_NAV_WAYPOINT, dialect.MAV_CMD_NAV_LOITER_TIME)
"""Items whose param1 is a time to stay."""


class Handover(Enum):
    """The runner has nothing more to fly; somebody else takes over."""

    FINISHED = auto()
    LANDED = auto()
    RETURN = auto()


class MissionState(Enum):
    """How far a mission is, as MISSION_CURRENT.mission_state has it."""

    NO_MISSION = dialect.MISSION_STATE_NO_MISSION
    NOT_STARTED = dialect.MISSION_STATE_NOT_STARTED
    ACTIVE = dialect.MISSION_STATE_ACTIVE
    PAUSED = dialect.MISSION_STATE_PAUSED
    COMPLETE = dialect.MISSION_STATE_COMPLETE


@dataclass(frozen=True, slots=True)
class Target:
    """Where the current item is flown to."""

    east_m: float
    north_m: float
    up_m: float
    radius_m: float
    passing_mps: float
    yaw_rad: float | None = None


class MissionRunner(MissionGeometry):
    """The cursor in a mission and the flying of it; `on_reached(seq)` is called for every item that is done.

    `utc(now_s)` gives the seconds since midnight UTC at a moment of fleet time (NAV_DELAY), `say` announces words.
    """

    first = 0
    """The item a mission begins with."""
    announces = True
    """Whether MISSION_CURRENT is sent at once when the item changes (PX4), or only as its stream has it."""
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
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__(frame, parameters)
        self.index = 0
        self.complete = False
        self.started = False
        self.speed_mps: float | None = None
        self._home_alt_m = home_alt_m
        self._on_reached = on_reached
        self._utc = utc
        self._say = say
        self._target: Target | None = None
        self._holding_since_s: float | None = None
        self._climb_first = False
        self._delay_until_s: float | None = None
        self._was: Place = (0.0, 0.0)

    @property
    def item(self) -> MissionItem:
        """The item being flown."""
        return self.mission.items[self.index]

    @property
    def told_index(self) -> int:
        """The item MISSION_CURRENT tells."""
        return self.index

    @property
    def told_total(self) -> int:
        """How many items MISSION_CURRENT tells of; PX4 says that it does not know when there are none."""
        return len(self.mission) or 0xFFFF

    @property
    def cruise_mps(self) -> float:
        """The ground speed in force: the last speed change, else MPC_XY_CRUISE."""
        return self._cruise(self.speed_mps)

    def state(self, *, flying: bool) -> MissionState:
        """Return how far the mission is; `flying`: the vehicle is armed and in the mission mode."""
        if not self.mission.items:
            return MissionState.NO_MISSION
        if self.complete:
            return MissionState.COMPLETE
        if flying:
            return MissionState.ACTIVE
        return MissionState.PAUSED if self.started else MissionState.NOT_STARTED

    def can_start(self, *, on_ground: bool) -> str | None:
        """Return why the mission cannot be flown now, or None."""
        del on_ground
        return None if self.mission.items else "Mission mode denied: no mission"

    def can_jump(self, seq: int) -> bool:
        """Whether there is an item `seq` to make current."""
        return 0 <= seq < len(self.mission)

    def leave(self) -> None:
        """Leave the mission mode."""

    def rewind(self) -> None:
        """Forget how far the mission was: the vehicle has disarmed."""

    def edit(self, mission: Mission, *, running: bool) -> bool:
        """Take a mission that is being written in place (ArduPilot); True if that restarted the current leg."""
        del mission, running
        return False

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
        if not self._has_item():
            return Handover.FINISHED
        for _ in range(len(self.mission) + 2):
            result = self._fly_item(body, now_s)
            if result is not None:
                self._was = (body.east_m, body.north_m)
                return result
            self._on_reached(self.item.seq)
            done = self.item.command
            if not self._advance():
                self.complete = True
                return Handover.LANDED if done == dialect.MAV_CMD_NAV_LAND else Handover.FINISHED
            self._forget()
        return Handover.FINISHED

    def _has_item(self) -> bool:
        return bool(self.mission.items)

    def _advance(self) -> bool:
        """Go on to the next item; False after the last one."""
        if self.index + 1 >= len(self.mission):
            return False
        self.index += 1
        return True

    def _fly_item(self, body: Body, now_s: float) -> Guidance | Handover | None:
        """Return guidance for the current item, or None once it is done."""
        item = self.item
        if item.command == dialect.MAV_CMD_DO_CHANGE_SPEED:
            self.speed_mps = changed_speed(self.speed_mps, item)
            return None
        if item.command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            self._on_reached(self.index)
            self.complete = True
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
        """Fix the target of the current item, seen from where the vehicle is now."""
        item = self.item
        self._was = (body.east_m, body.north_m)
        east_m, north_m = self._place(item) or self._was
        up_m = body.up_m if item.command == dialect.MAV_CMD_NAV_LAND else item.relative_alt_m(self._home_alt_m)
        if body.on_ground and item.command != dialect.MAV_CMD_NAV_LAND:
            up_m = max(up_m, self._parameters.tuning.takeoff_alt_m)
        self._climb_first = body.on_ground and item.command != dialect.MAV_CMD_NAV_LAND
        passing = self.passing_speed(self.index, self._was, (east_m, north_m), self.speed_mps, self.look_ahead)
        self._target = Target(east_m, north_m, up_m, self._radius(item), passing, self._yaw(item))
        return self._target

    def _delay(self, body: Body, now_s: float) -> Guidance | None:
        """Stay until the relative (param1) or the absolute time (UTC hour, minute, second); too late is tomorrow."""
        item = self.item
        if self._delay_until_s is None:
            wait_s = item.param1
            if wait_s < 0.0:
                of_day = sum(max(part, 0.0) * unit for part, unit in zip(_time_of(item), (3600, 60, 1), strict=True))
                wait_s = (of_day - self._utc(now_s)) % DAY_S
            self._say(f"Delaying {wait_s:.0f} sec")
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
            if near > target.radius_m or abs(target.up_m - body.up_m) > self._parameters.tuning.altitude_radius_m:
                return False
            self._holding_since_s = now_s
        if self.item.command == dialect.MAV_CMD_NAV_LOITER_UNLIM:
            return False
        hold_s = self.item.param1 if self.item.command in _HOVERS else 0.0
        return now_s - self._holding_since_s >= hold_s

    def _towards(self, body: Body, target: Target) -> Guidance:
        passing = target.passing_mps
        if passing > 0.0:
            limits = self._parameters.limits
            rise_m = target.up_m - body.up_m
            vertical_s = rise_m / limits.climb_mps if rise_m > 0.0 else -rise_m / limits.descend_mps
            late = vertical_s > body.distance_to(target.east_m, target.north_m) / max(self.cruise_mps, 0.1)
            if late and abs(rise_m) > self._parameters.tuning.altitude_radius_m:
                passing = 0.0
        place = (target.east_m, target.north_m, target.up_m)
        return Guidance(*place, self.cruise_mps, passing, yaw_rad=target.yaw_rad)

    def _yaw(self, item: MissionItem) -> float | None:
        """Return the heading a waypoint asks for (param4, degrees); NaN leaves it along the course."""
        wanted = item.command == dialect.MAV_CMD_NAV_WAYPOINT and math.isfinite(item.param4)
        return math.radians(item.param4) if wanted else None

    def _forget(self) -> None:
        self._target = self._delay_until_s = None
        self._holding_since_s = None


def _time_of(item: MissionItem) -> tuple[float, float, float]:
    """Return hour, minute and second of a NAV_DELAY; what is not given (negative or NaN) counts as 0."""
    parts = [part if math.isfinite(part) else 0.0 for part in (item.param2, item.param3, item.param4)]
    return parts[0], parts[1], parts[2]
