"""COMMAND_LONG and COMMAND_INT -> COMMAND_ACK. What is not in a flavour's table is answered UNSUPPORTED.

Here is what both flavours do alike; `sim.px4_commands` and `sim.ardupilot_commands` add their own.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.missions import NOT_GIVEN, RELATIVE_FRAMES
from skyfolio.sim.modes import Mode
from skyfolio.sim.wire import Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

ACCEPTED = dialect.MAV_RESULT_ACCEPTED
REJECTED_FOR_NOW = dialect.MAV_RESULT_TEMPORARILY_REJECTED
DENIED = dialect.MAV_RESULT_DENIED
UNSUPPORTED = dialect.MAV_RESULT_UNSUPPORTED
FAILED = dialect.MAV_RESULT_FAILED
AUTOPILOT_VERSION = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
HOME_POSITION = dialect.MAVLINK_MSG_ID_HOME_POSITION
FORCE = 21196
"""param2 of MAV_CMD_COMPONENT_ARM_DISARM that overrules the safety checks."""


class Command(NamedTuple):
    """One command, however it was sent: parameters 1-4, place in degrees or None, altitude as sent, MAV_FRAME."""

    id: int
    param1: float
    param2: float
    param3: float
    param4: float
    lat_deg: float | None
    lon_deg: float | None
    alt_m: float | None
    frame: int
    is_int: bool

    @classmethod
    def from_message(cls, message: Any) -> "Command":
        """Return the command in a COMMAND_LONG (floats, NaN: not given) or COMMAND_INT (1e-7 degrees)."""
        head = (message.command, message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == "COMMAND_INT":
            lat, lon = (None if raw == NOT_GIVEN else raw / 1e7 for raw in (message.x, message.y))
            return cls(*head, lat, lon, _given(message.z), message.frame, True)
        place = (_given(message.param5), _given(message.param6), _given(message.param7))
        return cls(*head, *place, dialect.MAV_FRAME_GLOBAL, False)


class Outcome(NamedTuple):
    """A MAV_RESULT, and messages that follow the acknowledgement."""

    result: int
    messages: tuple[Message, ...] = ()


class Commands(ABC):
    """The command table of one autopilot."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._table: dict[int, Callable[[Command], Outcome]] = {
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            dialect.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            dialect.MAV_CMD_NAV_LAND: self._land,
            dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._go_home,
            dialect.MAV_CMD_DO_SET_MODE: self._set_mode,
            dialect.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            dialect.MAV_CMD_DO_REPOSITION: self._reposition,
            dialect.MAV_CMD_MISSION_START: self._mission_start,
            dialect.MAV_CMD_DO_SET_MISSION_CURRENT: self._set_mission_current,
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            dialect.MAV_CMD_RUN_PREARM_CHECKS: self._prearm_checks,
            dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda _: self._send(
                dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            ),
            dialect.MAV_CMD_GET_HOME_POSITION: lambda _: self._send(HOME_POSITION),
        }

    def handle(self, message: Any) -> list[Message]:
        """Return the acknowledgement of a command, and what it asked for."""
        handler = self._table.get(message.command)
        outcome = Outcome(UNSUPPORTED) if handler is None else handler(Command.from_message(message))
        ack: Message = dialect.MAVLink_command_ack_message(
            message.command,
            outcome.result,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
        )
        return [*outcome.messages, ack] if self._message_first else [ack, *outcome.messages]

    @abstractmethod
    def set_mode_message(self, message: Any) -> list[Message]:
        """Take the old SET_MODE message, which only PX4 acknowledges."""

    @abstractmethod
    def _arm_disarm(self, command: Command) -> Outcome: ...

    @abstractmethod
    def _takeoff(self, command: Command) -> Outcome: ...

    @abstractmethod
    def _set_mode(self, command: Command) -> Outcome: ...

    def _go_home(self, command: Command) -> Outcome:
        del command
        return self._mode(Mode.RTL)

    def _land(self, command: Command) -> Outcome:
        del command
        return self._mode(Mode.LAND)

    @abstractmethod
    def _reboot(self, command: Command) -> Outcome: ...

    @abstractmethod
    def _mode(self, mode: Mode) -> Outcome: ...

    @abstractmethod
    def _change_speed(self, command: Command) -> Outcome: ...

    @abstractmethod
    def _reposition(self, command: Command) -> Outcome: ...

    @abstractmethod
    def _mission_start(self, command: Command) -> Outcome: ...

    @abstractmethod
    def _set_mission_current(self, command: Command) -> Outcome: ...

    def _place(self, command: Command) -> tuple[float | None, float | None, float | None] | None:
        """Return (east, north, up) metres as far as they are given, or None for a place that is not on the globe."""
        autopilot = self._autopilot
        east_m = north_m = up_m = None
        if command.lat_deg is not None and command.lon_deg is not None:
            if abs(command.lat_deg) > 90.0 or abs(command.lon_deg) > 180.0:
                return None
            east_m, north_m = autopilot.frame.to_local(command.lat_deg, command.lon_deg)
        if command.alt_m is not None:
            up_m = command.alt_m - (0.0 if command.frame in RELATIVE_FRAMES else autopilot.spec.home_alt_m)
        return east_m, north_m, up_m

    def _request_message(self, command: Command) -> Outcome:
        return self._send(index_of(command.param1))

    def _send(self, message_id: int) -> Outcome:
        message = self._autopilot.telemetry.build(message_id)
        return Outcome(self._unknown_message) if message is None else Outcome(ACCEPTED, (message,))

    _unknown_message = DENIED
    _message_first = False
    """Whether a message that was asked for comes before the acknowledgement."""

    def _set_message_interval(self, command: Command) -> Outcome:
        if not math.isfinite(command.param2):
            return Outcome(DENIED)
        known = self._autopilot.telemetry.set_interval(index_of(command.param1), command.param2 / 1e6)
        return Outcome(ACCEPTED if known else FAILED)

    def _prearm_checks(self, command: Command) -> Outcome:
        del command
        return Outcome(REJECTED_FOR_NOW if self._autopilot.armed else ACCEPTED)


def _given(value: float) -> float | None:
    return value if math.isfinite(value) else None


def index_of(value: float) -> int:
    """Return a number sent as a float; -1, which is never an index, for one that is none."""
    return int(value) if 0.0 <= value < math.inf else -1
