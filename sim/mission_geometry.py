"""Where a mission's items are, and how fast its corners may be flown."""

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import LocalFrame, Place, corner_speed
from skyfolio.sim.kinematics import BRAKING_SHARE, JERK_SHARE, jerk_limited_approach
from skyfolio.sim.missions import Mission, MissionItem
from skyfolio.sim.parameter_store import ParameterStore


class MissionGeometry:
    """A mission in local metres, under a vehicle's parameters."""

    def __init__(self, frame: LocalFrame, parameters: ParameterStore) -> None:
        self.mission = Mission()
        self._frame = frame
        self._parameters = parameters

    def passing_speed(self, index: int, start: Place, corner: Place, speed: float | None, depth: int) -> float:
        """Return the speed at the corner of item `index`, reached from `start`, that the legs after it allow.

        `speed` is the speed change in force, `depth` how many corners ahead are considered. 0: the vehicle stops there.
        """
        if depth == 0 or index >= len(self.mission):
            return 0.0
        item = self.mission.items[index]
        if item.command != dialect.MAV_CMD_NAV_WAYPOINT or item.param1 > 0.0:
            return 0.0
        for following in range(index + 1, len(self.mission)):
            after = self.mission.items[following]
            if not after.is_nav:
                speed = changed_speed(speed, after)
                continue
            goal = self._place(after)
            if goal is None:
                return 0.0
            acceleration = BRAKING_SHARE * self._parameters.limits.acceleration_mps2
            beyond = self.passing_speed(following, corner, goal, speed, depth - 1)
            leg = self._leg_speed(math.dist(corner, goal), beyond)
            turn = corner_speed(start, corner, goal, acceleration, self._radius(item))
            return min(leg, turn, self._cruise(speed))
        return 0.0

    def _leg_speed(self, length_m: float, passing_mps: float) -> float:
        """Return the highest speed a leg may begin with to be left at `passing_mps`."""
        limits = self._parameters.limits
        braking = BRAKING_SHARE * limits.acceleration_mps2
        if limits.jerk_mps3 == math.inf:
            return math.hypot(passing_mps, math.sqrt(2.0 * braking * length_m))
        return jerk_limited_approach(length_m, braking, JERK_SHARE * limits.jerk_mps3, passing_mps)

    def _place(self, item: MissionItem) -> Place | None:
        return self._frame.to_local(item.x / 1e7, item.y / 1e7) if item.has_place else None

    def _radius(self, item: MissionItem) -> float:
        own = item.command == dialect.MAV_CMD_NAV_WAYPOINT and item.param2 > 0.0
        return item.param2 if own else self._parameters.tuning.acceptance_radius_m

    def _cruise(self, speed_mps: float | None) -> float:
        limits = self._parameters.limits
        return min(limits.cruise_speed_mps if speed_mps is None else speed_mps, limits.max_speed_mps)


def changed_speed(speed_mps: float | None, item: MissionItem) -> float | None:
    """Return the speed in force after DO_CHANGE_SPEED: -1 keeps it, -2 goes back to the default."""
    if item.param2 > 0.0:
        return item.param2
    return None if item.param2 == -2.0 else speed_mps
