"""COMMAND_LONG and COMMAND_INT -> COMMAND_ACK. What is not in the table is answered UNSUPPORTED."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.missions import NOT_GIVEN
from sim.modes import Mode
from sim.wire import Message

if TYPE_CHECKING:
    from sim.autopilot import Autopilot

ACCEPTED = dialect.MAV_RESULT_ACCEPTED
REJECTED_FOR_NOW = dialect.MAV_RESULT_TEMPORARILY_REJECTED
DENIED = dialect.MAV_RESULT_DENIED
UNSUPPORTED = dialect.MAV_RESULT_UNSUPPORTED
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

    @classmethod
    def from_message(cls, message: Any) -> "Command":
        """Return the command in a COMMAND_LONG (floats, NaN: not given) or COMMAND_INT (1e-7 degrees)."""
        head = (message.command, message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == "COMMAND_INT":
            lat, lon = (None if raw == NOT_GIVEN else raw / 1e7 for raw in (message.x, message.y))
            return cls(*head, lat, lon, _given(message.z), message.frame)
        place = (_given(message.param5), _given(message.param6), _given(message.param7))
        return cls(*head, *place, dialect.MAV_FRAME_GLOBAL)


class Outcome(NamedTuple):
    """A MAV_RESULT, and messages that follow the acknowledgement."""

    result: int
    messages: tuple[Message, ...] = ()


class Commands:
    """The command table of one autopilot."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        self._table: dict[int, Callable[[Command], Outcome]] = {
            dialect.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            dialect.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            dialect.MAV_CMD_NAV_LAND: lambda _: self._mode(Mode.LAND),
            dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self._mode(Mode.RTL),
            dialect.MAV_CMD_DO_SET_MODE: self._set_mode,
            dialect.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            dialect.MAV_CMD_DO_REPOSITION: self._reposition,
            dialect.MAV_CMD_MISSION_START: self._mission_start,
            dialect.MAV_CMD_DO_SET_MISSION_CURRENT: self._set_mission_current,
            dialect.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
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
        return [ack, *outcome.messages]

    def _arm_disarm(self, command: Command) -> Outcome:
        if command.param1 == 1.0:
            done = self._autopilot.arm()
        elif command.param1 == 0.0:
            done = self._autopilot.disarm(force=command.param2 == FORCE)
        else:
            return Outcome(UNSUPPORTED)
        return Outcome(ACCEPTED if done else DENIED)

    def _takeoff(self, command: Command) -> Outcome:
        """Param7 is above sea level, as PX4 has it; without it MIS_TAKEOFF_ALT counts."""
        up_m = None if command.alt_m is None else command.alt_m - self._autopilot.spec.home_alt_m
        self._autopilot.takeoff(up_m if up_m is not None and up_m > 0.0 else None)
        return Outcome(ACCEPTED)

    def _set_mode(self, command: Command) -> Outcome:
        mode = Mode.from_command(command.param2, command.param3)
        custom = command.param1 >= 0.0 and _index(command.param1) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if not custom or mode is None:
            return Outcome(UNSUPPORTED)
        return self._mode(mode)

    def _mode(self, mode: Mode) -> Outcome:
        return Outcome(ACCEPTED if self._autopilot.set_mode(mode) else REJECTED_FOR_NOW)

    def _change_speed(self, command: Command) -> Outcome:
        if not math.isfinite(command.param2):
            return Outcome(DENIED)
        if command.param2 > 0.0:
            self._autopilot.runner.speed_mps = command.param2
        elif command.param2 == -2.0:
            self._autopilot.runner.speed_mps = None
        return Outcome(ACCEPTED)

    def _reposition(self, command: Command) -> Outcome:
        autopilot = self._autopilot
        east_m = north_m = up_m = None
        if command.lat_deg is not None and command.lon_deg is not None:
            if abs(command.lat_deg) > 90.0 or abs(command.lon_deg) > 180.0:
                return Outcome(DENIED)
            east_m, north_m = autopilot.frame.to_local(command.lat_deg, command.lon_deg)
        if command.alt_m is not None:
            relative = (dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
            up_m = command.alt_m - (0.0 if command.frame in relative else autopilot.spec.home_alt_m)
        autopilot.reposition(east_m, north_m, up_m, command.param1)
        return Outcome(ACCEPTED)

    def _mission_start(self, command: Command) -> Outcome:
        """Start at item param1 and arm, as PX4 does."""
        if not self._autopilot.jump(_index(command.param1)) or not self._autopilot.set_mode(Mode.MISSION):
            return Outcome(REJECTED_FOR_NOW)
        return Outcome(ACCEPTED if self._autopilot.arm() else DENIED)

    def _set_mission_current(self, command: Command) -> Outcome:
        return Outcome(ACCEPTED if self._autopilot.jump(_index(command.param1)) else DENIED)

    def _request_message(self, command: Command) -> Outcome:
        message = self._autopilot.telemetry.build(_index(command.param1))
        return Outcome(DENIED) if message is None else Outcome(ACCEPTED, (message,))

    def _set_message_interval(self, command: Command) -> Outcome:
        if not math.isfinite(command.param2):
            return Outcome(DENIED)
        known = self._autopilot.telemetry.set_interval(_index(command.param1), command.param2 / 1e6)
        return Outcome(ACCEPTED if known else DENIED)


def _given(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _index(value: float) -> int:
    """Return a number sent as a float; -1, which is never an index, for one that is none."""
    return int(value) if 0.0 <= value < math.inf else -1
