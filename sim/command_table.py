"""COMMAND_LONG and COMMAND_INT -> COMMAND_ACK. A command that is not in a flavour's table is answered UNSUPPORTED.

Here is what both flavours do alike; `sim.px4_commands` and `sim.ardupilot_commands` add their own.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.component_failures import ComponentFailures
from skyfolio.sim.hosts import Announcer, Commandable, Equipment, VehicleState
from skyfolio.sim.missions import NOT_GIVEN, RELATIVE_FRAMES
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.onboard_plans import Plans
from skyfolio.sim.telemetry_streams import Telemetry
from skyfolio.sim.wire import Message

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
    """One command, however it was sent: param1 to param4, and a place.

    lat_deg, lon_deg (WGS 84) and alt_m (metres above the level of `frame`, a MAV_FRAME) are None if they are not
    given. is_int: it was a COMMAND_INT.
    """

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
            return cls(*head, lat, lon, _finite(message.z), message.frame, True)
        place = (_finite(message.param5), _finite(message.param6), _finite(message.param7))
        return cls(*head, *place, dialect.MAV_FRAME_GLOBAL, False)


class Outcome(NamedTuple):
    """A MAV_RESULT, and messages that follow the acknowledgement."""

    result: int
    messages: tuple[Message, ...] = ()


class CommandHost(VehicleState, Equipment, Announcer, Commandable, Protocol):
    """The vehicle that takes commands."""

    component_failures: ComponentFailures
    navigator: Navigator
    plans: Plans
    telemetry: Telemetry

    def arm(self, *, force: bool = False) -> bool:
        """Arm; return whether its checks allow it."""

    def takeoff(self, up_m: float | None) -> None:
        """Climb above this place to `up_m` metres above home (None: to the take-off parameter)."""

    def reposition(self, east_m: float | None, north_m: float | None, up_m: float | None, speed_mps: float) -> None:
        """Hold at a place and height (metres; None keeps the present one); a speed <= 0 means the cruise speed."""


class Commands(ABC):
    """The command table of one autopilot."""

    def __init__(self, host: CommandHost) -> None:
        self._host = host
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
        """Return the COMMAND_ACK of a command, and the messages it requests."""
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
        """Return (east, north, up) in metres, each None if it is not given; None for a place off the globe."""
        host = self._host
        east_m = north_m = up_m = None
        if command.lat_deg is not None and command.lon_deg is not None:
            if abs(command.lat_deg) > 90.0 or abs(command.lon_deg) > 180.0:
                return None
            east_m, north_m = host.frame.to_local(command.lat_deg, command.lon_deg)
        if command.alt_m is not None:
            up_m = command.alt_m - (0.0 if command.frame in RELATIVE_FRAMES else host.spec.home_alt_m)
        return east_m, north_m, up_m

    def _request_message(self, command: Command) -> Outcome:
        return self._send(index_of(command.param1))

    def _send(self, message_id: int) -> Outcome:
        message = self._host.telemetry.build(message_id)
        return Outcome(self._unknown_message) if message is None else Outcome(ACCEPTED, (message,))

    _unknown_message = DENIED
    _message_first = False
    """Whether a requested message is sent before the acknowledgement."""

    def _set_message_interval(self, command: Command) -> Outcome:
        if not math.isfinite(command.param2):
            return Outcome(DENIED)
        is_streamed = self._host.telemetry.set_interval(index_of(command.param1), command.param2 / 1e6)
        return Outcome(ACCEPTED if is_streamed else FAILED)

    def _prearm_checks(self, command: Command) -> Outcome:
        del command
        return Outcome(REJECTED_FOR_NOW if self._host.armed else ACCEPTED)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def index_of(value: float) -> int:
    """Return the index that a float carries; -1, which is never an index, for a negative number, infinity or NaN."""
    return int(value) if 0.0 <= value < math.inf else -1
