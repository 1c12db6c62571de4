"""The parameter protocol: PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET -> PARAM_VALUE.

PX4 sends integers bytewise inside the float, refuses values out of range and reports unknown names; ArduPilot
casts them to float, takes any finite value and does not answer for an unknown name. Every parameter here has
an effect: `tuning` is derived anew whenever one is set.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.kinematics import Limits
from skyfolio.sim.tuning import Tuning
from skyfolio.sim.wire import Message, text

INT8 = dialect.MAV_PARAM_TYPE_INT8
INT16 = dialect.MAV_PARAM_TYPE_INT16
INT32 = dialect.MAV_PARAM_TYPE_INT32
REAL32 = dialect.MAV_PARAM_TYPE_REAL32
BY_NAME = -1
"""PARAM_REQUEST_READ.param_index when the parameter is requested by name."""


class Parameter(NamedTuple):
    """A parameter's default, range and MAV_PARAM_TYPE; without a type, integers have an int default."""

    name: str
    default: float
    low: float
    high: float
    wire_type: int | None = None

    @property
    def type(self) -> int:
        """MAV_PARAM_TYPE of the value."""
        if self.wire_type is not None:
            return self.wire_type
        return int(INT32 if isinstance(self.default, int) else REAL32)


class ParameterStore:
    """Values by name, what they mean (`tuning`), and the messages that read and set them.

    `bytewise` is PX4's way (see the module). Values survive a reboot of the vehicle.
    """

    def __init__(
        self, parameters: Sequence[Parameter], derive: Callable[[Mapping[str, float]], Tuning], *, bytewise: bool
    ) -> None:
        self._parameters = sorted(parameters)
        self._derive = derive
        self._bytewise = bytewise
        self._index = {parameter.name: index for index, parameter in enumerate(self._parameters)}
        self._values = {parameter.name: parameter.default for parameter in self._parameters}
        self._handlers: dict[str, Callable[[Any], list[Message]]] = {
            "PARAM_REQUEST_LIST": self._list,
            "PARAM_REQUEST_READ": self._read,
            "PARAM_SET": self._set,
        }
        self.tuning = derive(self._values)

    @property
    def limits(self) -> Limits:
        """What the airframe and its tuning allow."""
        return self.tuning.limits

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __setitem__(self, name: str, value: float) -> None:
        """Set a value; KeyError for an unknown name, ValueError outside the parameter's range."""
        parameter = self._parameters[self._index[name]]
        if not parameter.low <= value <= parameter.high:
            raise ValueError(f"{name} must be between {parameter.low} and {parameter.high}, got {value}")
        self._put(parameter, value)

    def __contains__(self, name: str) -> bool:
        return name in self._values

    @property
    def messages(self) -> frozenset[str]:
        """Names of the messages that this protocol answers."""
        return frozenset(self._handlers)

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming parameter message."""
        return self._handlers[message.get_type()](message)

    def _put(self, parameter: Parameter, value: float) -> None:
        self._values[parameter.name] = float(value) if parameter.type == REAL32 else int(value)
        self.tuning = self._derive(self._values)

    def _list(self, message: Any) -> list[Message]:
        del message
        return [self._value_message(parameter) for parameter in self._parameters]

    def _read(self, message: Any) -> list[Message]:
        if message.param_index != BY_NAME:
            in_range = 0 <= message.param_index < len(self._parameters)
            return [self._value_message(self._parameters[message.param_index])] if in_range else []
        index = self._index.get(message.param_id)
        return self._unknown(message.param_id) if index is None else [self._value_message(self._parameters[index])]

    def _set(self, message: Any) -> list[Message]:
        index = self._index.get(message.param_id)
        if index is None:
            return self._unknown(message.param_id)
        parameter = self._parameters[index]
        if self._bytewise and message.param_type != parameter.type:
            return [text(f"param types mismatch param: {parameter.name}", dialect.MAV_SEVERITY_ERROR)]
        value = self._from_wire(message.param_value, parameter.type)
        if math.isfinite(value) and (not self._bytewise or parameter.low <= value <= parameter.high):
            self._put(parameter, max(-(2.0**31), min(2.0**31 - 1.0, value)))
        return [self._value_message(parameter)]

    def _value_message(self, parameter: Parameter) -> Message:
        message: Message = dialect.MAVLink_param_value_message(
            parameter.name.encode(),
            self._to_wire(self._values[parameter.name], parameter.type),
            parameter.type,
            len(self._parameters),
            self._index[parameter.name],
        )
        return message

    def _unknown(self, name: str) -> list[Message]:
        return [text(f"unknown param: {name}", dialect.MAV_SEVERITY_ERROR)] if self._bytewise else []

    def _to_wire(self, value: float, kind: int) -> float:
        if self._bytewise and kind != REAL32:
            return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
        return float(value)

    def _from_wire(self, value: float, kind: int) -> float:
        if self._bytewise and kind != REAL32:
            return int(struct.unpack("<i", struct.pack("<f", value))[0])
        return value
