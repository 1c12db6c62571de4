"""Which part of an autopilot answers which message."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.ftp import FileServer
from skyfolio.sim.setpoints import MESSAGES as SETPOINTS
from skyfolio.sim.setpoints import setpoint_of
from skyfolio.sim.wire import AUTOPILOT_COMPONENT, Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

Handler = Callable[[Any], list[Message]]


class Inbox:
    """The messages one autopilot understands; all others are ignored without a word."""

    def __init__(self, autopilot: "Autopilot") -> None:
        self._autopilot = autopilot
        commands = autopilot.flavour.commands(autopilot)
        self._handlers: dict[str, Handler] = {
            "COMMAND_LONG": commands.handle,
            "COMMAND_INT": commands.handle,
            "SET_MODE": commands.set_mode_message,
            "HEARTBEAT": self._heartbeat,
            "PING": self._ping,
            "TIMESYNC": self._timesync,
            "REQUEST_DATA_STREAM": self._request_data_stream,
            **dict.fromkeys(autopilot.missions.messages, autopilot.missions.handle),
            **dict.fromkeys(autopilot.parameters.messages, autopilot.parameters.handle),
            **dict.fromkeys(SETPOINTS, self._setpoint),
        }
        if autopilot.files:
            self._handlers["FILE_TRANSFER_PROTOCOL"] = FileServer(autopilot.files).handle

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming message, for its sender only; messages for others are ignored."""
        handler = self._handlers.get(message.get_type())
        return handler(message) if handler is not None and self._is_for_us(message) else []

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self._autopilot.spec.system_id) and component in (0, AUTOPILOT_COMPONENT)

    def _heartbeat(self, message: Any) -> list[Message]:
        self._autopilot.failsafes.heard(message, self._autopilot.protocol_clock())
        return []

    def _ping(self, message: Any) -> list[Message]:
        if message.target_system != 0:
            return []
        who = (message.get_srcSystem(), message.get_srcComponent())
        return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *who)]

    def _timesync(self, message: Any) -> list[Message]:
        """Answer a request (tc1 = 0) with our time in ns; answers of others are none of our business."""
        if message.tc1 != 0:
            return []
        return [dialect.MAVLink_timesync_message(self._autopilot.telemetry.boot_ns, message.ts1)]

    def _request_data_stream(self, message: Any) -> list[Message]:
        rate_hz = float(message.req_message_rate) if message.start_stop else 0.0
        self._autopilot.telemetry.set_group(message.req_stream_id, rate_hz)
        return []

    def _setpoint(self, message: Any) -> list[Message]:
        autopilot = self._autopilot
        setpoint = setpoint_of(message, autopilot.frame, autopilot.spec.home_alt_m, autopilot.seen, autopilot.now_s)
        if setpoint is not None:
            autopilot.follow(setpoint)
        return []
