"""What a PX4 orders by itself, to system its own, component 0: COMMAND_LONG that a ground station hears as well.

Its navigator hands speed changes of a mission, the camera trigger and the gimbal to whoever feels addressed; nobody
acknowledges, so each is said four times, with the confirmation counted up (recordings of PX4 1.18).
"""

import math
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.wire import Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

REPEATS_S = (0.0, 0.5, 1.0, 2.0)
"""When each order is said, after its first time."""
GIMBAL_AFTER_S = 0.27
_ROI_NONE = (1001, (-3.0, -3.0, -1.0, -1.0, 0.0, 0.0, 0.0))
_PITCH_YAW = (1000, (math.nan, math.nan, math.nan, math.nan, 2.0, 0.0, 0.0))
_TRIGGER_OFF = (dialect.MAV_CMD_DO_TRIGGER_CONTROL, (-1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
_RETURN = (dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH, (0.0,) * 7)
Order = tuple[int, tuple[float, ...]]


class Chatter:
    """The orders one autopilot gives; one that gives none (ArduPilot) keeps silent."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._due: list[tuple[float, int, Message]] = []
        self._count = 0

    def speed_changed(self, speed_mps: float) -> None:
        """Tell of a speed change of the mission."""
        self._order((dialect.MAV_CMD_DO_CHANGE_SPEED, (1.0, speed_mps, -1.0, 0.0, 0.0, 0.0, 0.0)))

    def mission_left(self, *, to_return: bool = False) -> None:
        """Stop camera and gimbal of a mission that is left; `to_return`: because its last item says so."""
        if to_return:
            self._order(_RETURN)
        self._order(_TRIGGER_OFF)
        own = (1001, (float(self._autopilot.spec.system_id), 1.0, -1.0, -1.0, 0.0, 0.0, 0.0))
        self._order(own, after_s=GIMBAL_AFTER_S)
        for order in (_PITCH_YAW, _ROI_NONE):
            self._order(order, after_s=GIMBAL_AFTER_S, times=1)

    def mission_disarmed(self) -> None:
        """Stop the camera of a mission that ended on the ground."""
        self._order(_TRIGGER_OFF)

    def due(self) -> list[Message]:
        """Return the orders to be said by now."""
        now_s = self._autopilot.now_s
        if not self._due or self._due[0][0] > now_s:
            return []
        said = [message for at_s, _, message in self._due if at_s <= now_s]
        self._due = self._due[len(said) :]
        return said

    def _order(self, order: Order, *, after_s: float = 0.0, times: int = len(REPEATS_S)) -> None:
        if not self._autopilot.flavour.gives_orders:
            return
        command, params = order
        for confirmation, repeat_s in enumerate(REPEATS_S[:times]):
            self._count += 1
            message = dialect.MAVLink_command_long_message(
                self._autopilot.spec.system_id, 0, command, confirmation, *params
            )
            self._due.append((self._autopilot.now_s + after_s + repeat_s, self._count, message))
        self._due.sort(key=lambda entry: entry[:2])
