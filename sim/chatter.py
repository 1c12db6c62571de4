"""What a PX4 orders by itself: COMMAND_LONG to its own system, component 0, which a ground station receives as well.

Its navigator sends speed changes of a mission, the camera trigger and the gimbal to any component that feels addressed.
None acknowledges, so each order is sent four times, with the confirmation counted up (recordings of PX4 1.18).
"""

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.onboard_clock import OnboardClock
from skyfolio.sim.wire import Message

REPEATS_S = (0.0, 0.5, 1.0, 2.0)
"""When each order is sent, in seconds after its first time."""
GIMBAL_AFTER_S = 0.27
_ROI_NONE = (1001, (-3.0, -3.0, -1.0, -1.0, 0.0, 0.0, 0.0))
_PITCH_YAW = (1000, (math.nan, math.nan, math.nan, math.nan, 2.0, 0.0, 0.0))
_TRIGGER_OFF = (dialect.MAV_CMD_DO_TRIGGER_CONTROL, (-1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
_RETURN = (dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH, (0.0,) * 7)
Order = tuple[int, tuple[float, ...]]


class Chatter:
    """The orders that one autopilot gives; one that gives none (ArduPilot, `gives_orders` False) sends nothing."""

    def __init__(self, system_id: int, clock: OnboardClock, *, gives_orders: bool) -> None:
        self._system_id = system_id
        self._clock = clock
        self._gives_orders = gives_orders
        self._queue: list[tuple[float, int, Message]] = []
        self._count = 0

    def reset(self) -> None:
        """Forget the orders that wait, as a reboot does."""
        self._queue.clear()

    @property
    def next_s(self) -> float:
        """When the next order is due, fleet seconds; infinite if none waits."""
        return self._queue[0][0] if self._queue else math.inf

    def speed_changed(self, speed_mps: float) -> None:
        """Send a speed change of the mission, m/s."""
        self._order((dialect.MAV_CMD_DO_CHANGE_SPEED, (1.0, speed_mps, -1.0, 0.0, 0.0, 0.0, 0.0)))

    def mission_left(self, *, to_return: bool = False) -> None:
        """Stop camera and gimbal of a mission that is left; `to_return`: because its last item orders a return."""
        if to_return:
            self._order(_RETURN)
        self._order(_TRIGGER_OFF)
        own = (1001, (float(self._system_id), 1.0, -1.0, -1.0, 0.0, 0.0, 0.0))
        self._order(own, after_s=GIMBAL_AFTER_S)
        for order in (_PITCH_YAW, _ROI_NONE):
            self._order(order, after_s=GIMBAL_AFTER_S, times=1)

    def mission_disarmed(self) -> None:
        """Stop the camera of a mission that ended on the ground."""
        self._order(_TRIGGER_OFF)

    def due(self) -> list[Message]:
        """Return the COMMAND_LONGs to be sent by now."""
        now_s = self._clock.now_s
        if not self._queue or self._queue[0][0] > now_s:
            return []
        messages = [message for at_s, _, message in self._queue if at_s <= now_s]
        self._queue = self._queue[len(messages) :]
        return messages

    def _order(self, order: Order, *, after_s: float = 0.0, times: int = len(REPEATS_S)) -> None:
        if not self._gives_orders:
            return
        command, params = order
        for confirmation, repeat_s in enumerate(REPEATS_S[:times]):
            self._count += 1
            message = dialect.MAVLink_command_long_message(self._system_id, 0, command, confirmation, *params)
            self._queue.append((self._clock.now_s + after_s + repeat_s, self._count, message))
        self._queue.sort(key=lambda entry: entry[:2])
