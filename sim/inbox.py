"""Which part of an autopilot answers which message."""

from collections.abc import Callable
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.command_table import Commands
from skyfolio.sim.failsafes import Failsafes
from skyfolio.sim.ftp import FileServer
from skyfolio.sim.hosts import Equipment, VehicleState
from skyfolio.sim.mission_protocol import MissionProtocol
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.setpoints import MESSAGES as SETPOINTS
from skyfolio.sim.setpoints import setpoint_of
from skyfolio.sim.telemetry_streams import Telemetry
from skyfolio.sim.wire import AUTOPILOT_COMPONENT, Message

Handler = Callable[[Any], list[Message]]


class InboxHost(VehicleState, Equipment, Protocol):
    """The vehicle that messages are for."""

    failsafes: Failsafes
    files: dict[str, bytes]
    missions: MissionProtocol
    navigator: Navigator
    protocol_clock: Callable[[], float]
    telemetry: Telemetry


class Inbox:
    """The messages that one autopilot understands; all others are ignored, without an answer."""

    def __init__(self, host: InboxHost, commands: Commands) -> None:
        self._host = host
        self._handlers: dict[str, Handler] = {
            "COMMAND_LONG": commands.handle,
            "COMMAND_INT": commands.handle,
            "SET_MODE": commands.set_mode_message,
            "HEARTBEAT": self._heartbeat,
            "PING": self._ping,
            "TIMESYNC": self._timesync,
            "REQUEST_DATA_STREAM": self._request_data_stream,
            **dict.fromkeys(host.missions.messages, host.missions.handle),
            **dict.fromkeys(host.parameters.messages, host.parameters.handle),
            **dict.fromkeys(SETPOINTS, self._setpoint),
        }
        if host.files:
            self._handlers["FILE_TRANSFER_PROTOCOL"] = FileServer(host.files).handle

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming message, for its sender only; messages for others are ignored."""
        handler = self._handlers.get(message.get_type())
        return handler(message) if handler is not None and self._is_for_us(message) else []

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self._host.spec.system_id) and component in (0, AUTOPILOT_COMPONENT)

    def _heartbeat(self, message: Any) -> list[Message]:
        self._host.failsafes.take_heartbeat(message, self._host.protocol_clock())
        return []

    def _ping(self, message: Any) -> list[Message]:
        if message.target_system != 0:
            return []
        sender = (message.get_srcSystem(), message.get_srcComponent())
        return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *sender)]

    def _timesync(self, message: Any) -> list[Message]:
        """Answer a request (tc1 = 0) with the time since boot in nanoseconds; ignore the answers to others."""
        if message.tc1 != 0:
            return []
        return [dialect.MAVLink_timesync_message(self._host.clock.boot_ms * 1_000_000, message.ts1)]

    def _request_data_stream(self, message: Any) -> list[Message]:
        rate_hz = float(message.req_message_rate) if message.start_stop else 0.0
        self._host.telemetry.set_group(message.req_stream_id, rate_hz)
        return []

    def _setpoint(self, message: Any) -> list[Message]:
        host = self._host
        setpoint = setpoint_of(message, host.frame, host.spec.home_alt_m, host.seen, host.clock.now_s)
        if setpoint is not None:
            host.navigator.follow(setpoint)
        return []
