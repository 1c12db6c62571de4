"""How ArduCopter flies a mission in AUTO, as measured on its software-in-the-loop build.

The mission begins at item 1 (0 is home). The acceptance radius is WPNAV_RADIUS, never the item's. The current index
survives an upload: each write into the mission restarts the current leg from where the vehicle is, and where the item
at the kept index has become a DO_ command, it moves on to the next leg. Cut short, the vehicle finishes the leg it has
loaded and the one after, then hovers. A waypoint with a hold counts as reached at rest; the next leg starts from rest.
A waypoint flown through counts once the target has gone the whole leg at its speed, however near the vehicle is.
Altitude changes along the leg, together with the place; a leg that is too steep for its speed is flown more slowly.
"""

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import Place
from skyfolio.sim.kinematics import Body, Guidance
from skyfolio.sim.mission_runner import MissionRunner
from skyfolio.sim.mission_state import Handover, MissionState, Target
from skyfolio.sim.missions import Mission, MissionItem
from skyfolio.sim.modes import Mode

_NAMES = {
    dialect.MAV_CMD_NAV_WAYPOINT: "WP",
    dialect.MAV_CMD_NAV_LOITER_UNLIM: "LoitUnlim",
    dialect.MAV_CMD_NAV_LOITER_TIME: "LoitTime",
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: "RTL",
    dialect.MAV_CMD_NAV_LAND: "Land",
    dialect.MAV_CMD_NAV_TAKEOFF: "Takeoff",
    dialect.MAV_CMD_NAV_DELAY: "Delay",
    dialect.MAV_CMD_DO_CHANGE_SPEED: "ChangeSpeed",
}
"""ArduCopter's names for the items of a mission."""
REST_MPS = 0.3
"""A stop is over once the vehicle is this slow at its point."""
REST_M = 0.5
LOOK_AHEAD_S = 0.5
"""The altitude that is flown to is that of the leg so far ahead: it follows the leg without lagging behind."""
_UPRIGHT_M = 1.0
"""A shorter leg is flown as a climb or a descent."""


class ArdupilotRunner(MissionRunner):
    """The mission in AUTO.

    `complete` is AP_Mission's MISSION_COMPLETE. `halted`: an item was set after that, and is not flown until
    the mission is started again.
    """

    first = 1
    look_ahead = 2

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.halted = False
        self._cut = False
        self._flying: MissionItem | None = None
        self._next: MissionItem | None = None
        self._announced: int | None = None
        self._looked_s: float | None = None
        self._to_go_m = self._leg_m = self._began_up_m = 0.0

    @property
    def item(self) -> MissionItem:
        """The item being flown; the loaded one, if the mission has been cut before it."""
        if self._cut and self._flying is not None:
            return self._flying
        return super().item

    @property
    def over(self) -> bool:
        """Whether there would be nothing to fly: the mission is over, or halted."""
        return self.halted or super().over

    def state(self, mode: Mode, *, armed: bool) -> MissionState:
        """Return MISSION_CURRENT.mission_state: active only in AUTO, armed and not halted."""
        if len(self.mission) <= self.first:
            return MissionState.NO_MISSION
        if self.complete:
            return MissionState.COMPLETE
        running = mode is Mode.MISSION and armed and not self.halted
        return MissionState.ACTIVE if running else MissionState.NOT_STARTED

    @property
    def reported_index(self) -> int:
        """MISSION_CURRENT.seq: the item that is flown, never a DO item on the way to it."""
        ahead = (item.seq for item in self.mission.items[self.index :] if item.is_nav)
        return next(ahead, self.index)

    @property
    def reported_total(self) -> int:
        """MISSION_CURRENT.total, without home."""
        return max(len(self.mission) - 1, 0)

    def can_jump(self, seq: int) -> bool:
        """Return whether there is anything to fly from item `seq` on."""
        return super().can_jump(seq) and any(item.is_nav for item in self.mission.items[max(seq, self.first) :])

    def can_start(self, *, on_ground: bool) -> str | None:
        """Return why AUTO cannot be flown: nothing but home on board, or on the ground without a take-off ahead."""
        if len(self.mission) <= self.first:
            return ""
        start = self.first if self.complete else max(self.index, self.first)
        ahead = next((item for item in self.mission.items[start:] if item.is_nav), None)
        if on_ground and (ahead is None or ahead.command != dialect.MAV_CMD_NAV_TAKEOFF):
            return "Auto: Missing Takeoff Cmd"
        return None

    def edit(self, mission: Mission, *, running: bool) -> bool:
        """Fly on by a mission that is being written in place; return whether the current leg restarts."""
        self.mission = mission
        exists = self.index < len(mission)
        self._cut = running and not exists and self._flying is not None
        if running and exists:
            self._forget()
        return running and exists

    def load(self, mission: Mission, *, on_ground: bool) -> None:
        """Take a complete mission; the index is kept, even past its end."""
        del on_ground
        self.mission = mission

    def jump(self, seq: int) -> None:
        """Make an item current, and fly it unless the mission was over; item 0 means the first one."""
        self.halted = self.complete or self.halted
        self.index = max(seq, self.first)
        self.complete = self._cut = False
        self._announced = None
        self._forget()

    def activate(self) -> None:
        """Enter AUTO: go on, or start over after the end; earlier speed changes are forgotten."""
        if self.complete or self._parameters.tuning.restart_mission:
            self.jump(self.first)
        self.index = max(self.index, self.first)
        self.halted = False
        self.started = True
        self.speed_mps = None
        self._forget()

    def leave(self) -> None:
        """Leave AUTO."""
        self._flying = self._next = self._announced = None
        self._cut = False

    def rewind(self) -> None:
        """Go back to the beginning, as ArduCopter does when it disarms; a mission that was over stays over."""
        self.index = 0
        self.halted = self.started = False
        self._announced = None
        self._forget()

    def forget_flight(self) -> None:
        """Start afresh with what is stored."""
        super().forget_flight()
        self.complete = False

    def fly(self, body: Body, now_s: float) -> Guidance | Handover:
        """Return where to go now."""
        return Handover.FINISHED if self.halted or self.complete else super().fly(body, now_s)

    def _fly_item(self, body: Body, now_s: float) -> Guidance | Handover | None:
        """Return guidance for the current item, and send STATUSTEXTs of the items begun and done."""
        item = self.item
        if self._announced != self.index:
            self._announced = self.index
            self._send_text(f"Mission: {self.index} {_NAMES.get(item.command, '?')}")
        result = super()._fly_item(body, now_s)
        if result is None and item.is_nav and item.command != dialect.MAV_CMD_NAV_LAND:
            self._send_text(f"Reached command #{self.index}")
        return result

    def _report_landed(self) -> None:
        """Send nothing, as an ArduCopter does."""

    def _has_item(self) -> bool:
        if self._cut:
            return True
        if self.index >= len(self.mission):
            self.complete = True
            return False
        self._load_ahead()
        return True

    def _load_ahead(self) -> None:
        """Load the current item and the next leg's, which are flown even if the mission is cut before them."""
        self._flying = self.mission.items[self.index]
        self._next = next((item for item in self.mission.items[self.index + 1 :] if item.is_nav), None)

    def _advance(self) -> bool:
        if self._cut:
            self._flying, self._next = self._next, None
            return self._flying is not None
        if not super()._advance():
            return False
        self._load_ahead()
        return True

    def _begin(self, body: Body) -> Target:
        """Set the target; only a take-off climbs first."""
        target = super()._begin(body)
        self._looked_s = None
        self._to_go_m = self._leg_m = body.distance_to(target.east_m, target.north_m)
        self._began_up_m = body.up_m
        self._climb_first = self.item.command == dialect.MAV_CMD_NAV_TAKEOFF
        return target

    def _has_climbed(self, body: Body, target: Target) -> bool:
        return abs(target.up_m - body.up_m) <= REST_M

    def _is_done(self, body: Body, target: Target, now_s: float) -> bool:
        passed_s = 0.0 if self._looked_s is None else now_s - self._looked_s
        self._to_go_m -= max(self._along_mps(target), body.ground_speed_mps) * passed_s
        self._looked_s = now_s
        if self._holding_since_s is None and self._to_go_m > 0.0:
            return False
        stops = target.passing_mps <= 0.0 and self.item.command != dialect.MAV_CMD_NAV_TAKEOFF
        if stops and self._holding_since_s is None:
            near = body.distance_to(target.east_m, target.north_m) <= REST_M
            if not near or body.ground_speed_mps > REST_MPS:
                return False
        return super()._is_done(body, target, now_s)

    def _passing_up_mps(self, body: Body, place: Place, up_m: float) -> float:
        """Return 0: the altitude goes with the way over ground (`_towards`)."""
        del body, place, up_m
        return 0.0

    def _towards(self, body: Body, target: Target) -> Guidance:
        """Return where to go: along the straight line of the leg, no faster than it may climb or descend on it."""
        guidance = super()._towards(body, target)
        if self._leg_m < _UPRIGHT_M:
            return guidance
        rise_m = target.up_m - self._began_up_m
        speed_mps = self._along_mps(target)
        to_go_m = max(body.distance_to(target.east_m, target.north_m) - LOOK_AHEAD_S * body.ground_speed_mps, 0.0)
        return guidance._replace(
            up_m=target.up_m - rise_m * min(to_go_m / self._leg_m, 1.0),
            speed_mps=speed_mps,
            passing_mps=min(guidance.passing_mps, speed_mps),
            passing_up_mps=abs(rise_m) / self._leg_m * body.ground_speed_mps,
        )

    def _along_mps(self, target: Target) -> float:
        """Return how fast the leg is flown over ground: as ordered, or as its slope allows."""
        limits, rise_m = self._parameters.limits, target.up_m - self._began_up_m
        most_mps = limits.climb_mps if rise_m > 0.0 else limits.descend_mps
        if self._leg_m < _UPRIGHT_M or abs(rise_m) * self.cruise_mps <= most_mps * self._leg_m:
            return self.cruise_mps
        return most_mps * self._leg_m / abs(rise_m)

    def _yaw(self, item: MissionItem) -> float | None:
        """Return None: ArduCopter keeps no yaw of a waypoint, the nose goes along the course (WP_YAW_BEHAVIOR)."""
        del item
        return None

    def _radius(self, item: MissionItem) -> float:
        del item
        return self._parameters.tuning.acceptance_radius_m

    def _place(self, item: MissionItem) -> Place | None:
        """Return where an item is; None for a take-off, which ArduCopter flies where it is."""
        return None if item.command == dialect.MAV_CMD_NAV_TAKEOFF else super()._place(item)
