"""The vehicle's own failsafes: ground station lost, battery low, position lost, fence broken, setpoints stopped.

Here is what is watched, the same for both; what is done and announced is each autopilot's (`sim.px4_failsafes`,
`sim.ardupilot_failsafes`), as its parameters (`sim.tuning`) have it. No failsafe replaces a stronger action by a milder
one: a vehicle that lands does not return because of a lesser failure.
"""

from abc import ABC, abstractmethod
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.boot import Boot
from skyfolio.sim.geofence import Fence
from skyfolio.sim.hosts import Announcer, Commandable, Equipment, VehicleState
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.tuning import Action, Breach, LowBattery

SEVERITY = [Action.NONE, Action.WARN, Action.HOLD, Action.RETURN, Action.LAND, Action.DISARM]
"""Actions from the mildest to the strongest."""
_DOING = {Mode.RTL: Action.RETURN, Mode.LAND: Action.LAND}


class FailsafeHost(VehicleState, Equipment, Announcer, Commandable, Protocol):
    """The vehicle that saves itself."""

    navigator: Navigator
    boot_plan: Boot


class Failsafes(ABC):
    """Watches one vehicle, and acts when something fails.

    `take_heartbeat` takes those of ground stations, `check` is called at each step. The times of those HEARTBEATs run
    on the protocol clock, because they come from outside.
    """

    position_loss_s: float
    """A position that is lost for this long is a failure."""

    def __init__(self, host: FailsafeHost, fence: Fence) -> None:
        self._host = host
        self._fence = fence
        self._heartbeat_s: float | None = None
        self.link_lost = False
        self._levels_passed = 0
        self._blind_since_s: float | None = None
        self.position_lost = False
        self._breach: Breach | None = None

    @property
    @abstractmethod
    def active(self) -> bool:
        """Whether HEARTBEAT.system_status is MAV_STATE_CRITICAL."""

    def take_heartbeat(self, message: Any, wall_s: float) -> None:
        """Take a HEARTBEAT received at a protocol time; it counts if it is the ground station's."""
        gcs = self._host.parameters.tuning.link_loss.gcs_system_id
        if message.type == dialect.MAV_TYPE_GCS and gcs in (None, message.get_srcSystem()):
            self._heartbeat_s = wall_s

    def thaw(self, frozen_wall_s: float) -> None:
        """Leave out a time, in seconds of the protocol clock, in which the autopilot hung and missed no HEARTBEAT."""
        if self._heartbeat_s is not None:
            self._heartbeat_s += frozen_wall_s

    @abstractmethod
    def taken_over(self) -> None:
        """End what is under way: a pilot or a ground station has chosen a mode."""

    @abstractmethod
    def disarmed(self) -> None:
        """End what is under way: the flight is over."""

    def check(self, now_s: float, wall_s: float) -> None:
        """Act on what has failed by `now_s` fleet time and `wall_s` protocol time."""
        self._check_link(wall_s)
        self._check_battery()
        self._check_position(now_s)
        self._check_fence()

    def _check_link(self, wall_s: float) -> None:
        timeout_s = self._host.parameters.tuning.link_loss.timeout_s
        lost = self._heartbeat_s is not None and wall_s - self._heartbeat_s >= timeout_s
        if lost != self.link_lost:
            self.link_lost = lost
            self._link_is_lost() if lost else self._link_is_back()

    def _check_battery(self) -> None:
        levels = self._host.parameters.tuning.batteries
        share = self._host.gauge.share
        passed = 0
        for level in levels:
            passed += share < level.share
        if passed > self._levels_passed:
            self._battery_fell(levels[self._levels_passed : passed])
        self._levels_passed = passed

    def _check_position(self, now_s: float) -> None:
        if self._host.satellites:
            self._blind_since_s = None
            if self.position_lost:
                self.position_lost = False
                self._position_is_back()
            return
        if not self._host.boot_plan.ready:
            return
        if self._blind_since_s is None:
            self._blind_since_s = now_s
        if not self.position_lost and now_s - self._blind_since_s >= self.position_loss_s:
            self.position_lost = True
            self._position_is_lost()

    def _check_fence(self) -> None:
        host = self._host
        rule = host.parameters.tuning.fence
        breach = None
        if rule.action is not Action.NONE and host.boot_plan.ready:
            breach = self._fence.breach(host.seen, rule, host.home_m)
        before, self._breach = self._breach, breach
        if breach is not None and before is None:
            self._fence_is_broken(breach)
        elif breach is None and before is not None:
            self._fence_is_whole()

    @property
    def _flying(self) -> bool:
        return self._host.armed and not self._host.body.on_ground

    def _milder_than_now(self, action: Action) -> bool:
        doing = _DOING.get(self._host.mode, Action.NONE)
        return SEVERITY.index(action) <= SEVERITY.index(doing)

    def _act(self, action: Action, cause: str, hold: Mode = Mode.HOLD) -> None:
        """Change the mode, or disarm; without a position every mode becomes a landing."""
        host = self._host
        host.emit("failsafe", {"cause": cause, "action": action.name})
        if action is Action.DISARM:
            host.disarm(force=True)
            return
        mode = {Action.HOLD: hold, Action.RETURN: Mode.RTL, Action.LAND: Mode.LAND}[action]
        if not host.set_mode(mode if host.satellites else Mode.LAND, by_failsafe=True):
            host.set_mode(Mode.LAND, by_failsafe=True)

    @abstractmethod
    def _link_is_lost(self) -> None: ...

    @abstractmethod
    def _link_is_back(self) -> None: ...

    @abstractmethod
    def _battery_fell(self, levels: tuple[LowBattery, ...]) -> None: ...

    @abstractmethod
    def _position_is_lost(self) -> None: ...

    @abstractmethod
    def _position_is_back(self) -> None: ...

    @abstractmethod
    def _fence_is_broken(self, breach: Breach) -> None: ...

    @abstractmethod
    def _fence_is_whole(self) -> None: ...
