"""The parameter protocol, PX4 flavour (integers travel bytewise inside the float), over a handful of live parameters.

Messages: PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET -> PARAM_VALUE. Each parameter here has an effect: the
next step of the vehicle flies by the new value.
"""

import math
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.vehicle import Limits
from sim.wire import Message, text

REAL32 = dialect.MAV_PARAM_TYPE_REAL32
INT32 = dialect.MAV_PARAM_TYPE_INT32
BY_NAME = -1
"""PARAM_REQUEST_READ.param_index when the parameter is asked for by name."""


class Parameter(NamedTuple):
    """A parameter's default and range; integers have an int default."""

    name: str
    default: float
    low: float
    high: float

    @property
    def type(self) -> int:
        """MAV_PARAM_TYPE of the value."""
        return int(INT32 if isinstance(self.default, int) else REAL32)


_LIMIT_OF = {
    "MPC_XY_VEL_MAX": "max_speed_mps",
    "MPC_XY_CRUISE": "cruise_speed_mps",
    "MPC_ACC_HOR": "acceleration_mps2",
    "MPC_Z_V_AUTO_UP": "climb_mps",
    "MPC_Z_V_AUTO_DN": "descend_mps",
    "MPC_LAND_SPEED": "land_mps",
    "MPC_LAND_ALT1": "land_slow_below_m",
    "MPC_ACC_UP_MAX": "climb_acceleration_mps2",
    "MPC_ACC_DOWN_MAX": "descend_acceleration_mps2",
}


def parameters_of(limits: Limits) -> list[Parameter]:
    """Return the parameters a vehicle with these limits boots with, in name order."""
    own = [
        Parameter("COM_DISARM_LAND", 2.0, -1.0, 60.0),
        Parameter("MAV_TYPE", 2, 0, 22),
        Parameter("MIS_TAKEOFF_ALT", 2.5, 0.0, 500.0),
        Parameter("MPC_Z_VEL_MAX_UP", limits.climb_mps, 0.5, 10.0),
        Parameter("MPC_Z_VEL_MAX_DN", max(limits.descend_mps, limits.land_mps), 0.5, 10.0),
        Parameter("NAV_ACC_RAD", 2.0, 0.05, 200.0),
        Parameter("NAV_MC_ALT_RAD", 0.8, 0.05, 200.0),
        Parameter("RTL_RETURN_ALT", 30.0, 0.0, 500.0),
    ]
    tuned = [Parameter(name, getattr(limits, attribute), 0.01, 100.0) for name, attribute in _LIMIT_OF.items()]
    return sorted(own + tuned)


class ParameterStore:
    """Values by name, and the messages that read and set them."""

    def __init__(self, limits: Limits) -> None:
        self._known = parameters_of(limits)
        self._index = {parameter.name: index for index, parameter in enumerate(self._known)}
        self._values = {parameter.name: parameter.default for parameter in self._known}
        self._handlers: dict[str, Callable[[Any], list[Message]]] = {
            "PARAM_REQUEST_LIST": self._list,
            "PARAM_REQUEST_READ": self._read,
            "PARAM_SET": self._set,
        }
        self.limits = self._limits()

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __setitem__(self, name: str, value: float) -> None:
        """Set a value; KeyError for an unknown name, ValueError outside the parameter's range."""
        parameter = self._known[self._index[name]]
        if not parameter.low <= value <= parameter.high:
            raise ValueError(f"{name} must be between {parameter.low} and {parameter.high}, got {value}")
        self._values[name] = int(value) if parameter.type == INT32 else float(value)
        self.limits = self._limits()

    @property
    def messages(self) -> frozenset[str]:
        """Names of the messages this protocol answers."""
        return frozenset(self._handlers)

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to one incoming parameter message."""
        return self._handlers[message.get_type()](message)

    def _list(self, message: Any) -> list[Message]:
        del message
        return [self._value_message(parameter) for parameter in self._known]

    def _read(self, message: Any) -> list[Message]:
        if message.param_index != BY_NAME:
            in_range = 0 <= message.param_index < len(self._known)
            return [self._value_message(self._known[message.param_index])] if in_range else []
        index = self._index.get(message.param_id)
        return [_unknown(message.param_id)] if index is None else [self._value_message(self._known[index])]

    def _set(self, message: Any) -> list[Message]:
        index = self._index.get(message.param_id)
        if index is None:
            return [_unknown(message.param_id)]
        parameter = self._known[index]
        if message.param_type != parameter.type:
            return [text(f"param types mismatch param: {parameter.name}", dialect.MAV_SEVERITY_ERROR)]
        value = _from_wire(message.param_value, parameter.type)
        if math.isfinite(value) and parameter.low <= value <= parameter.high:
            self[parameter.name] = value
        return [self._value_message(parameter)]

    def _value_message(self, parameter: Parameter) -> Message:
        message: Message = dialect.MAVLink_param_value_message(
            parameter.name.encode(),
            _to_wire(self._values[parameter.name], parameter.type),
            parameter.type,
            len(self._known),
            self._index[parameter.name],
        )
        return message

    def _limits(self) -> Limits:
        values = {attribute: self._values[name] for name, attribute in _LIMIT_OF.items()}
        values["climb_mps"] = min(values["climb_mps"], self._values["MPC_Z_VEL_MAX_UP"])
        values["descend_mps"] = min(values["descend_mps"], self._values["MPC_Z_VEL_MAX_DN"])
        return Limits(**values)


def _unknown(name: str) -> Message:
    return text(f"unknown param: {name}", dialect.MAV_SEVERITY_ERROR)


def _to_wire(value: float, kind: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", int(value)))[0]) if kind == INT32 else value


def _from_wire(value: float, kind: int) -> float:
    return int(struct.unpack("<i", struct.pack("<f", value))[0]) if kind == INT32 else value
