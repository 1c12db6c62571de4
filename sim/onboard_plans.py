"""The vehicle's side of the mission protocol: what an accepted or edited plan does to the one who flies by it."""

import math
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import Place
from skyfolio.sim.geofence import Fence
from skyfolio.sim.mission_protocol import MISSION
from skyfolio.sim.missions import NOT_GIVEN, Mission, MissionItem
from skyfolio.sim.modes import Mode
from skyfolio.sim.telemetry_messages import mission_current
from skyfolio.sim.wire import Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

_FENCE, _RALLY = dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_RALLY


class Plans:
    """Mission, fence and rally points of one autopilot (`sim.mission_protocol.MissionHost`)."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self.fence = Fence(autopilot.frame)

    @property
    def mission_index(self) -> int:
        """The mission item being flown."""
        return self._autopilot.runner.index

    @property
    def mission_running(self) -> bool:
        """Whether it is armed and flies its mission."""
        autopilot = self._autopilot
        return autopilot.armed and autopilot.mode is Mode.MISSION and not autopilot.runner.complete

    def plan_accepted(self, mission_type: int, plan: Mission) -> None:
        """Take a whole plan."""
        autopilot = self._autopilot
        if mission_type == _FENCE:
            self.fence.load(plan)
        if mission_type != MISSION:
            kind = "fence_accepted" if mission_type == _FENCE else "rally_accepted"
            autopilot.emit(kind, {"items": plan.items})
            if mission_type == _FENCE and autopilot.flavour.words.fence_taken:
                autopilot.say(autopilot.flavour.words.fence_taken, dialect.MAV_SEVERITY_DEBUG)
            return
        autopilot.runner.load(plan, on_ground=autopilot.body.on_ground)
        if autopilot.mode is Mode.MISSION:
            autopilot.runner.started = True
        autopilot.emit("mission_accepted", {"mission_id": plan.mission_id, "items": plan.items})

    def mission_edited(self, mission: Mission) -> None:
        """Take a mission that is being written in place."""
        if self._autopilot.runner.edit(mission, running=self.mission_running):
            self._autopilot.say("Auto mission changed, restarted command")

    def jump(self, seq: int) -> bool:
        """Make mission item `seq` current; False if there is none."""
        return self._autopilot.jump(seq)

    def current_message(self, seq: int) -> Message:
        """Return a MISSION_CURRENT that tells this item."""
        return mission_current(self._autopilot, seq)

    def guide(self, item: MissionItem) -> bool:
        """Fly to a mission item sent on its own, in GUIDED; one without a place changes the height only."""
        autopilot = self._autopilot
        if autopilot.mode is not Mode.GUIDED or NOT_GIVEN in (item.x, item.y):
            return False
        there = item.has_place
        east_m, north_m = autopilot.frame.to_local(item.x / 1e7, item.y / 1e7) if there else (None, None)
        autopilot.navigator.go_to(east_m, north_m, item.relative_alt_m(autopilot.spec.home_alt_m), 0.0)
        return True

    def home_item(self) -> MissionItem:
        """Return home as ArduPilot's item 0."""
        autopilot = self._autopilot
        lat, lon = autopilot.frame.to_geodetic(*autopilot.home_m)
        place = (round(lat * 1e7), round(lon * 1e7), autopilot.spec.home_alt_m)
        command = dialect.MAV_CMD_NAV_WAYPOINT
        return MissionItem(0, dialect.MAV_FRAME_GLOBAL, command, 0, 1, 0.0, 0.0, 0.0, 0.0, *place)

    def return_point(self) -> Place:
        """Return where a return ends: home, or a rally point that is nearer to the vehicle."""
        autopilot = self._autopilot
        limit_m = autopilot.parameters.tuning.rally_limit_m
        items = autopilot.missions.plan(_RALLY).items
        rally = [autopilot.frame.to_local(item.x / 1e7, item.y / 1e7) for item in items]
        near = [place for place in rally if math.dist(place, autopilot.home_m) <= limit_m]
        here = (autopilot.seen.east_m, autopilot.seen.north_m)
        return min([autopilot.home_m, *near], key=lambda place: math.dist(place, here))
