"""Read a handful of parameters of one autopilot by name, without I/O (PARAM_REQUEST_READ -> PARAM_VALUE).

PX4 sends integers bytewise inside the float (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE), ArduPilot as numbers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from math import inf
from typing import Any

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.mission_messages import AUTOPILOT_COMPONENT, Message
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.round_trip import RoundTrip

_AGAIN_S = 0.3
_ROUNDS = 3
_REAL32 = 9
_BY_NAME = -1


class ParameterRead:
    """Requests all names at once, and again those that are not answered; `values` has what the vehicle knows.

    An autopilot sends nothing (or a text) for an unknown name, so unknown names end with the last round.
    """

    def __init__(
        self, names: Iterable[str], system_id: int, autopilot: Autopilot, round_trip: RoundTrip | None = None
    ) -> None:
        self.values: dict[str, float] = {}
        self.ended = False
        self._missing = list(dict.fromkeys(names))
        self._system_id, self._autopilot = system_id, autopilot
        self._round_trip = round_trip or RoundTrip()
        self._round = 0
        self._asked_s = 0.0

    @property
    def due_s(self) -> float:
        """Return when `tick` has something to do."""
        return inf if self.ended else self._asked_s + _AGAIN_S + 1.5 * self._round_trip.seconds

    def start(self, now_s: float) -> list[Message]:
        """Request everything."""
        self.ended = not self._missing
        self._round, self._asked_s = 1, now_s
        return [self._request(name) for name in self._missing]

    def handle(self, name: str, fields: dict[str, Any], now_s: float) -> list[Message]:
        """Take in one message."""
        del now_s
        parameter = str(fields.get("param_id", "")).rstrip("\0")
        if name == "PARAM_VALUE" and parameter in self._missing:
            self._missing.remove(parameter)
            self.values[parameter] = parameter_value(fields, self._autopilot)
            self.ended = not self._missing
        return []

    def tick(self, now_s: float) -> list[Message]:
        """Request again what is missing."""
        if self.ended or now_s < self.due_s:
            return []
        if self._round == _ROUNDS:
            self.ended = True
            return []
        self._round += 1
        self._asked_s = now_s
        return [self._request(name) for name in self._missing]

    def give_up(self) -> None:
        """Stop requesting."""
        self.ended = True

    def _request(self, name: str) -> Message:
        fields = {"param_id": name, "param_index": _BY_NAME}
        address = {"target_system": self._system_id, "target_component": AUTOPILOT_COMPONENT}
        return Message("PARAM_REQUEST_READ", {**address, **fields})


def parameter_value(fields: dict[str, Any], autopilot: Autopilot) -> float:
    """Return the number in a PARAM_VALUE. A bytewise -1 is NaN as a float, and comes as None from JSON."""
    value = fields["param_value"]
    if not profile_of(autopilot).bytewise_parameters or int(fields["param_type"]) == _REAL32:
        return float("nan") if value is None else float(value)
    if value is None:
        return -1.0
    return float(struct.unpack("<i", struct.pack("<f", float(value)))[0])
