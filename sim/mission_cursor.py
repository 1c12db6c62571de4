"""How far a vehicle is in its mission, and what it reports of that; as PX4 counts it, unless a flavour overrides it."""

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.mission_geometry import MissionGeometry
from skyfolio.sim.mission_state import MISSION_MODES, NOTHING_REACHED, MissionState
from skyfolio.sim.missions import MissionItem
from skyfolio.sim.modes import Mode
from skyfolio.sim.parameter_store import ParameterStore


class MissionCursor(MissionGeometry):
    """The place in a mission.

    `index`: the item being flown. `complete`: there is nothing more to fly. `finished`: what PX4 reports as complete,
    which a take-off by command sets too. `started`: the mission has been entered. `reached`: the last item done since
    the mission or its index changed. `speed_mps`: the last speed change, None for the cruise speed.
    """

    first = 0
    """The item with which a mission begins."""

    def __init__(self, frame: LocalFrame, parameters: ParameterStore) -> None:
        super().__init__(frame, parameters)
        self.index = 0
        self.complete = False
        self.finished = False
        self.started = False
        self.reached = NOTHING_REACHED
        self.speed_mps: float | None = None
        self._state = MissionState.NOT_STARTED

    @property
    def item(self) -> MissionItem:
        """The item being flown."""
        return self.mission.items[self.index]

    @property
    def reported_index(self) -> int:
        """MISSION_CURRENT.seq."""
        return self.index

    @property
    def reported_total(self) -> int:
        """MISSION_CURRENT.total; PX4 sends 65535 (unknown) when there are no items."""
        return len(self.mission) or 0xFFFF

    @property
    def cruise_mps(self) -> float:
        """The ground speed in force, m/s: the last speed change, else MPC_XY_CRUISE."""
        return self._cruise(self.speed_mps)

    @property
    def over(self) -> bool:
        """Whether there would be nothing to fly, were the vehicle in the mission mode."""
        return self.complete or not self.mission.items

    @property
    def taking_off(self) -> bool:
        """Whether the item being flown is a take-off."""
        items = self.mission.items
        return self.index < len(items) and items[self.index].command == dialect.MAV_CMD_NAV_TAKEOFF

    @property
    def ends_with_return(self) -> bool:
        """Whether the mission is complete because it has come to a RETURN_TO_LAUNCH."""
        return self.complete and bool(self.mission.items) and self.item.command == dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH

    def state(self, mode: Mode, *, armed: bool) -> MissionState:
        """Return MISSION_CURRENT.mission_state.

        PX4 counts a take-off and a landing by command as part of the mission; once done, they finish it.
        """
        del armed
        if not self.mission.items:
            self._state = MissionState.NO_MISSION
        elif self.finished:
            self._state = MissionState.COMPLETE
        elif mode in MISSION_MODES:
            self._state = MissionState.ACTIVE
        elif self.reached > NOTHING_REACHED:
            self._state = MissionState.PAUSED
        elif self.index < 1:
            self._state = MissionState.NOT_STARTED
        return self._state

    def can_start(self, *, on_ground: bool) -> str | None:
        """Return why the mission cannot be flown now ("" if the autopilot does not send why), or None if it can."""
        del on_ground
        return None if self.mission.items else ""

    def can_jump(self, seq: int) -> bool:
        """Return whether there is an item `seq` to make current."""
        return 0 <= seq < len(self.mission)
