"""What a vehicle sends without being asked: streams and their rates, in fleet time.

`sim.telemetry_messages` fills the messages.
"""

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.metadata import COMPONENT_METADATA, metadata_message
from skyfolio.sim.mission_state import NOTHING_REACHED
from skyfolio.sim.telemetry_messages import BUILDERS, MessageHost, mission_current
from skyfolio.sim.wire import Message

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


class StreamHost(MessageHost, Protocol):
    """The vehicle that sends."""

    files: dict[str, bytes]


class Telemetry:
    """The streams of one autopilot, and every message that can be requested from it (MAV_CMD_REQUEST_MESSAGE).

    The streams begin at fleet time `start_s`, shifted by a `phase` in [0, 1) of their interval.
    """

    def __init__(self, host: StreamHost, *, start_s: float, phase: float) -> None:
        self._host = host
        self._defaults_hz = host.traits.rates_hz
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        for message_id, rate_hz in self._defaults_hz.items():
            self._interval_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = start_s + (0.0 if message_id == _ALWAYS_FIRST else phase / rate_hz)
        self._next_s = start_s
        self._announced: tuple[int, bool] | None = None
        self._reached: int | None = None
        self._repeats = 0

    @property
    def next_s(self) -> float:
        """When the next stream is due, fleet seconds."""
        return self._next_s

    def build(self, message_id: int) -> Message | None:
        """Return the message of an id as of now, or None if the vehicle does not have it."""
        if message_id == COMPONENT_METADATA and self._host.files:
            return metadata_message(self._host.clock.boot_ms, self._host.files)
        builder = BUILDERS.get(message_id)
        return builder(self._host) if builder else None

    def mission_current(self, seq: int) -> Message:
        """Return a MISSION_CURRENT that names item `seq`."""
        return mission_current(self._host, seq)

    def set_interval(self, message_id: int, interval_s: float) -> bool:
        """Set a stream's interval in seconds (0: default, negative: off); return whether it can be streamed."""
        if message_id not in BUILDERS:
            return False
        default = self._defaults_hz.get(message_id)
        if interval_s < 0.0 or (interval_s == 0.0 and default is None):
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
            return True
        self._interval_s[message_id] = max(interval_s, FASTEST_INTERVAL_S) if interval_s else 1.0 / (default or 1.0)
        self._due_s[message_id] = self._next_s = self._host.clock.now_s
        return True

    def set_group(self, group: int, rate_hz: float) -> None:
        """Set the rate of a group of streams in Hz (0: off; MAV_DATA_STREAM_ALL: every group)."""
        groups = list(GROUPS) if group == dialect.MAV_DATA_STREAM_ALL else [group]
        for member in groups:
            for message_id in GROUPS.get(member, ()):
                self.set_interval(message_id, 1.0 / rate_hz if rate_hz > 0.0 else -1.0)

    def mission_set(self) -> None:
        """Announce no change of the current item: one that a ground station sets is sent with the stream only."""
        runner = self._host.runner
        self._announced = (runner.index, runner.finished)

    def item_reached(self, seq: int) -> None:
        """Announce that mission item `seq` is done; of several done in one step only the last is announced."""
        self._reached = seq

    def mission_news(self) -> list[Message]:
        """Return what the mission adds to the streams since the last call: MISSION_CURRENT, MISSION_ITEM_REACHED.

        Only PX4 sends MISSION_CURRENT whenever the index changes or the mission ends.
        """
        runner = self._host.runner
        before, self._announced = self._announced, (runner.index, runner.finished)
        if before == self._announced and self._reached is None:
            return []
        messages: list[Message] = []
        if self._host.traits.announces_mission and before not in (None, self._announced) and runner.mission.items:
            messages += filter(None, [self.build(MISSION_CURRENT)])
        reached, self._reached = self._reached, None
        if reached is not None:
            self._repeats = REACHED_REPEATS
            messages.append(dialect.MAVLink_mission_item_reached_message(reached))
        return messages

    def _reached_again(self) -> list[Message]:
        reached = self._host.runner.reached
        if not self._host.traits.announces_mission or reached == NOTHING_REACHED or self._repeats <= 0:
            return []
        self._repeats -= 1
        return [dialect.MAVLink_mission_item_reached_message(reached)]

    def due(self, now_s: float) -> list[Message]:
        """Return the messages due by fleet time `now_s`; a late stream sends once, however many intervals it missed."""
        if now_s < self._next_s:
            return []
        messages = []
        for message_id, due_s in self._due_s.items():
            if due_s <= now_s:
                message = BUILDERS[message_id](self._host)
                if message is not None:
                    messages.append(message)
                if message_id == MISSION_CURRENT:
                    messages += self._reached_again()
                interval_s = self._interval_s[message_id]
                missed = math.floor((now_s - due_s) / interval_s)
                self._due_s[message_id] = due_s + (missed + 1) * interval_s
        self._next_s = min(self._due_s.values(), default=math.inf)
        return messages
