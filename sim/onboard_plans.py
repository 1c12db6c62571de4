"""The vehicle behind the mission protocol: what an accepted or edited plan does to the flight."""

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import Place
from skyfolio.sim.geofence import Fence
from skyfolio.sim.hosts import Announcer, Equipment, VehicleState
from skyfolio.sim.mission_protocol import MISSION, MissionProtocol
from skyfolio.sim.missions import NOT_GIVEN, Mission, MissionItem
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.telemetry_streams import Telemetry
from skyfolio.sim.wire import Message

_FENCE, _RALLY = dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_RALLY


class PlansHost(VehicleState, Equipment, Announcer, Protocol):
    """The vehicle that flies by its plans."""

    missions: MissionProtocol
    navigator: Navigator
    telemetry: Telemetry


class Plans:
    """Mission, fence and rally points of one autopilot (a `sim.mission_protocol.MissionHost`)."""

    def __init__(self, host: PlansHost) -> None:
        self._host = host
        self.fence = Fence(host.frame)

    @property
    def mission_index(self) -> int:
        """The mission item being flown."""
        return self._host.runner.index

    @property
    def mission_running(self) -> bool:
        """Whether the vehicle is armed and flies its mission."""
        host = self._host
        return host.armed and host.mode is Mode.MISSION and not host.runner.complete

    def plan_accepted(self, mission_type: int, plan: Mission) -> None:
        """Put a complete plan of a MAV_MISSION_TYPE into force (events "mission_accepted", ...)."""
        host = self._host
        if mission_type == _FENCE:
            self.fence.load(plan)
        if mission_type != MISSION:
            kind = "fence_accepted" if mission_type == _FENCE else "rally_accepted"
            host.emit(kind, {"items": plan.items})
            if mission_type == _FENCE and host.traits.words.fence_taken:
                host.send_text(host.traits.words.fence_taken, dialect.MAV_SEVERITY_DEBUG)
            return
        host.runner.load(plan, on_ground=host.body.on_ground)
        if host.mode is Mode.MISSION:
            host.runner.started = True
        host.emit("mission_accepted", {"mission_id": plan.mission_id, "items": plan.items})

    def mission_edited(self, mission: Mission) -> None:
        """Fly on by a mission that is being written in place."""
        if self._host.runner.edit(mission, running=self.mission_running):
            self._host.send_text("Auto mission changed, restarted command")

    def jump(self, seq: int) -> bool:
        """Make mission item `seq` current without announcing it; return whether there is such an item."""
        if not self._host.runner.can_jump(seq):
            return False
        self._host.runner.jump(seq)
        self._host.telemetry.mission_set()
        return True

    def current_message(self, seq: int) -> Message:
        """Return a MISSION_CURRENT that names item `seq`."""
        return self._host.telemetry.mission_current(seq)

    def guide(self, item: MissionItem) -> bool:
        """Fly to an item sent on its own; return False outside GUIDED. One without a place changes only the height."""
        host = self._host
        if host.mode is not Mode.GUIDED or NOT_GIVEN in (item.x, item.y):
            return False
        has_place = item.has_place
        east_m, north_m = host.frame.to_local(item.x / 1e7, item.y / 1e7) if has_place else (None, None)
        host.navigator.go_to(east_m, north_m, item.relative_alt_m(host.spec.home_alt_m), 0.0)
        return True

    def home_item(self) -> MissionItem:
        """Return home as ArduPilot's item 0."""
        host = self._host
        lat, lon = host.frame.to_geodetic(*host.home_m)
        place = (round(lat * 1e7), round(lon * 1e7), host.spec.home_alt_m)
        command = dialect.MAV_CMD_NAV_WAYPOINT
        return MissionItem(0, dialect.MAV_FRAME_GLOBAL, command, 0, 1, 0.0, 0.0, 0.0, 0.0, *place)

    def return_point(self) -> Place:
        """Return where a return ends, metres east and north: home, or a rally point nearer to the vehicle."""
        host = self._host
        limit_m = host.parameters.tuning.rally_limit_m
        items = host.missions.plan(_RALLY).items
        rally = [host.frame.to_local(item.x / 1e7, item.y / 1e7) for item in items]
        near = [place for place in rally if math.dist(place, host.home_m) <= limit_m]
        here = (host.seen.east_m, host.seen.north_m)
        return min([host.home_m, *near], key=lambda place: math.dist(place, here))
