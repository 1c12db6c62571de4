"""What a vehicle tells unasked: streams in fleet time and their rates; `sim.telemetry_messages` fills the messages."""

import math
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.metadata import COMPONENT_METADATA, metadata_message
from skyfolio.sim.mission_state import NOTHING_REACHED
from skyfolio.sim.telemetry_messages import BUILDERS, boot_ms
from skyfolio.sim.wire import Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

FASTEST_INTERVAL_S = 0.02
GROUPS: dict[int, tuple[int, ...]] = {
    dialect.MAV_DATA_STREAM_RAW_SENSORS: (dialect.MAVLINK_MSG_ID_GPS_RAW_INT,),
    dialect.MAV_DATA_STREAM_EXTENDED_STATUS: (
        dialect.MAVLINK_MSG_ID_SYS_STATUS,
        dialect.MAVLINK_MSG_ID_MISSION_CURRENT,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT,
    ),
    dialect.MAV_DATA_STREAM_POSITION: (
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    dialect.MAV_DATA_STREAM_EXTRA1: (dialect.MAVLINK_MSG_ID_ATTITUDE,),
    dialect.MAV_DATA_STREAM_EXTRA2: (dialect.MAVLINK_MSG_ID_VFR_HUD,),
    dialect.MAV_DATA_STREAM_EXTRA3: (dialect.MAVLINK_MSG_ID_BATTERY_STATUS, dialect.MAVLINK_MSG_ID_SYSTEM_TIME),
}
"""REQUEST_DATA_STREAM groups, as ArduPilot fills them."""
MISSION_CURRENT = dialect.MAVLINK_MSG_ID_MISSION_CURRENT
REACHED_REPEATS = 10
"""How often a PX4 repeats MISSION_ITEM_REACHED, once a second."""
_ALWAYS_FIRST = dialect.MAVLINK_MSG_ID_HEARTBEAT


class Telemetry:
    """The streams of one autopilot, and every message it can be asked for (MAV_CMD_REQUEST_MESSAGE)."""

    def __init__(self, autopilot: "Autopilot", *, start_s: float, phase: float) -> None:
        self._autopilot = autopilot
        self._defaults_hz = autopilot.flavour.rates_hz
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        for message_id, rate_hz in self._defaults_hz.items():
            self._interval_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = start_s + (0.0 if message_id == _ALWAYS_FIRST else phase / rate_hz)
        self._next_s = start_s
        self._told: tuple[int, bool] | None = None
        self._repeats = 0

    @property
    def boot_ns(self) -> int:
        """The autopilot's clock in nanoseconds since boot."""
        return boot_ms(self._autopilot) * 1_000_000

    def build(self, message_id: int) -> Message | None:
        """Return the message as of now, or None if the vehicle does not know it."""
        if message_id == COMPONENT_METADATA and self._autopilot.files:
            return metadata_message(boot_ms(self._autopilot), self._autopilot.files)
        builder = BUILDERS.get(message_id)
        return builder(self._autopilot) if builder else None

    def set_interval(self, message_id: int, interval_s: float) -> bool:
        """Set a stream's interval (0: default, negative: off); False for a message that cannot be streamed."""
        if message_id not in BUILDERS:
            return False
        default = self._defaults_hz.get(message_id)
        if interval_s < 0.0 or (interval_s == 0.0 and default is None):
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
            return True
        self._interval_s[message_id] = max(interval_s, FASTEST_INTERVAL_S) if interval_s else 1.0 / (default or 1.0)
        self._due_s[message_id] = self._next_s = self._autopilot.now_s
        return True

    def set_group(self, group: int, rate_hz: float) -> None:
        """Set the rate of a group of streams (0: off; MAV_DATA_STREAM_ALL: every group)."""
        groups = list(GROUPS) if group == dialect.MAV_DATA_STREAM_ALL else [group]
        for one in groups:
            for message_id in GROUPS.get(one, ()):
                self.set_interval(message_id, 1.0 / rate_hz if rate_hz > 0.0 else -1.0)

    def keep_to_itself(self) -> None:
        """Take what the mission has come to for told: what a ground station sets comes with the stream only."""
        runner = self._autopilot.runner
        self._told = (runner.index, runner.finished)

    def mission_news(self, reached: int | None) -> list[Message]:
        """Return what is to be told of the mission beside its stream; `reached`: the last item done since.

        Only one item is told of when several are done at once, the last. PX4 tells whenever index or end change.
        """
        messages: list[Message] = []
        runner = self._autopilot.runner
        told, self._told = self._told, (runner.index, runner.finished)
        if self._autopilot.flavour.tells_mission and told not in (None, self._told) and runner.mission.items:
            messages += filter(None, [self.build(MISSION_CURRENT)])
        if reached is not None:
            self._repeats = REACHED_REPEATS
            messages.append(dialect.MAVLink_mission_item_reached_message(reached))
        return messages

    def _reached_again(self) -> list[Message]:
        reached = self._autopilot.runner.reached
        if not self._autopilot.flavour.tells_mission or reached == NOTHING_REACHED or self._repeats <= 0:
            return []
        self._repeats -= 1
        return [dialect.MAVLink_mission_item_reached_message(reached)]

    def due(self, now_s: float) -> list[Message]:
        """Return the messages whose time has come; a stream that is late sends once, not once for each miss."""
        if now_s < self._next_s:
            return []
        messages = []
        for message_id, due_s in self._due_s.items():
            if due_s <= now_s:
                message = BUILDERS[message_id](self._autopilot)
                if message is not None:
                    messages.append(message)
                if message_id == MISSION_CURRENT:
                    messages += self._reached_again()
                interval_s = self._interval_s[message_id]
                missed = math.floor((now_s - due_s) / interval_s)
                self._due_s[message_id] = due_s + (missed + 1) * interval_s
        self._next_s = min(self._due_s.values(), default=math.inf)
        return messages
