"""The vehicle's own failsafes: ground station gone, battery low, position lost, fence broken, setpoints gone.

Here is what is watched, the same for both; what is done and said is each autopilot's (`sim.px4_failsafes`,
`sim.ardupilot_failsafes`), as its parameters (`sim.tuning`) have it. None makes things milder: a vehicle that lands
does not return because of a lesser failure.
"""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.modes import Mode
from skyfolio.sim.tuning import Action, Breach, LowBattery

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

SEVERITY = [Action.NONE, Action.WARN, Action.HOLD, Action.RETURN, Action.LAND, Action.DISARM]
_DOING = {Mode.RTL: Action.RETURN, Mode.LAND: Action.LAND}


class Failsafes(ABC):
    """Watches one vehicle. `heard` is told of messages, `check` is called each step; times of HEARTBEATs of ground
    stations run on the protocol clock, because they come from outside."""

    position_loss_s: float
    """A position that is gone this long is a failure."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._heard_s: float | None = None
        self.link_lost = False
        self._levels_passed = 0
        self._blind_since_s: float | None = None
        self.position_lost = False
        self._breach: Breach | None = None

    @property
    @abstractmethod
    def active(self) -> bool:
        """Whether HEARTBEAT.system_status says critical."""

    def heard(self, message: Any, wall_s: float) -> None:
        """Take a HEARTBEAT; it counts if it is the ground station's."""
        gcs = self._autopilot.parameters.tuning.link_loss.gcs_system_id
        if message.type == dialect.MAV_TYPE_GCS and gcs in (None, message.get_srcSystem()):
            self._heard_s = wall_s

    def thaw(self, frozen_wall_s: float) -> None:
        """Go on after a while in which nothing ran: nobody was missed in it."""
        if self._heard_s is not None:
            self._heard_s += frozen_wall_s

    @abstractmethod
    def taken_over(self) -> None:
        """Hear of a mode that somebody chose."""

    @abstractmethod
    def disarmed(self) -> None:
        """Hear of the end of a flight."""

    def check(self, now_s: float, wall_s: float) -> None:
        """Let the failsafes act that are due."""
        self._check_link(wall_s)
        self._check_battery()
        self._check_position(now_s)
        self._check_fence()

    def _check_link(self, wall_s: float) -> None:
        timeout_s = self._autopilot.parameters.tuning.link_loss.timeout_s
        lost = self._heard_s is not None and wall_s - self._heard_s >= timeout_s
        if lost != self.link_lost:
            self.link_lost = lost
            self._link_is_lost() if lost else self._link_is_back()

    def _check_battery(self) -> None:
        levels = self._autopilot.parameters.tuning.batteries
        passed = sum(self._autopilot.battery.share < level.share for level in levels)
        if passed > self._levels_passed:
            self._battery_fell(levels[self._levels_passed : passed])
        self._levels_passed = passed

    def _check_position(self, now_s: float) -> None:
        if self._autopilot.satellites:
            self._blind_since_s = None
            if self.position_lost:
                self.position_lost = False
                self._position_is_back()
            return
        if not self._autopilot.boot_plan.ready:
            return
        if self._blind_since_s is None:
            self._blind_since_s = now_s
        if not self.position_lost and now_s - self._blind_since_s >= self.position_loss_s:
            self.position_lost = True
            self._position_is_lost()

    def _check_fence(self) -> None:
        autopilot = self._autopilot
        rule = autopilot.parameters.tuning.fence
        breach = None
        if rule.action is not Action.NONE and autopilot.boot_plan.ready:
            breach = autopilot.plans.fence.breach(autopilot.seen, rule, autopilot.home_m)
        before, self._breach = self._breach, breach
        if breach is not None and before is None:
            self._fence_is_broken(breach)
        elif breach is None and before is not None:
            self._fence_is_whole()

    @property
    def _flying(self) -> bool:
        return self._autopilot.armed and not self._autopilot.body.on_ground

    def _milder_than_now(self, action: Action) -> bool:
        doing = _DOING.get(self._autopilot.mode, Action.NONE)
        return SEVERITY.index(action) <= SEVERITY.index(doing)

    def _act(self, action: Action, cause: str, hold: Mode = Mode.HOLD) -> None:
        """Change the mode, or disarm; without a position a return is a landing."""
        autopilot = self._autopilot
        autopilot.emit("failsafe", {"cause": cause, "action": action.name})
        if action is Action.DISARM:
            autopilot.disarm(force=True)
            return
        mode = {Action.HOLD: hold, Action.RETURN: Mode.RTL, Action.LAND: Mode.LAND}[action]
        if not autopilot.set_mode(mode if autopilot.satellites else Mode.LAND, by_failsafe=True):
            autopilot.set_mode(Mode.LAND, by_failsafe=True)

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
