"""The vocabulary of the mission protocol: types, results, messages, and how long to wait for an answer."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

GROUND = (245, 190)
"""System and component id of MAVSDK's ground station: who we are on the link."""
AUTOPILOT_COMPONENT = 1
SILENCE_S = 3.0
"""A transfer in which nothing was heard for this long has failed (PX4 gives up after 5 s, ArduPilot after 8 s)."""


class MissionType(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


class Ack(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


PASSING = frozenset({Ack.ERROR, Ack.DENIED, Ack.OPERATION_CANCELLED, Ack.INVALID_SEQUENCE})
"""Answers that trying again may change: somebody else's transfer, a time-out, a confusion about what is next."""


class Message(NamedTuple):
    """One outgoing message, fields as named in the MAVLink definition."""

    name: str
    fields: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a transfer ended. `error` None: well. `opaque_id`: checksum the vehicle told, 0 if none.

    `passing`: trying again may help. `perhaps_done`: everything was sent, only the vehicle's last word is missing.
    """

    error: str | None = None
    passing: bool = True
    perhaps_done: bool = False
    opaque_id: int = 0


class RoundTrip:
    """How long to wait for an answer: smoothed round trip and its deviation, as TCP does it (RFC 6298)."""

    def __init__(self, *, initial_s: float = 0.3, least_s: float = 0.045, most_s: float = 1.0) -> None:
        self._least_s, self._most_s = least_s, most_s
        self._smooth_s: float | None = None
        self._deviation_s = 0.0
        self._wait_s = initial_s
        self._patience = 1.0

    @property
    def timeout_s(self) -> float:
        """Seconds after which an answer is overdue."""
        return min(max(self._wait_s * self._patience, self._least_s), self._most_s)

    def measured(self, seconds: float) -> None:
        """Take in one round trip of a message that was sent once (Karn's rule)."""
        if self._smooth_s is None:
            self._smooth_s, self._deviation_s = seconds, seconds / 2
        else:
            self._deviation_s += 0.25 * (abs(self._smooth_s - seconds) - self._deviation_s)
            self._smooth_s += 0.125 * (seconds - self._smooth_s)
        self._wait_s = self._smooth_s + 4 * self._deviation_s

    def missed(self) -> None:
        """Wait half as long again next time: the link may have become slower."""
        self._patience = min(1.5 * self._patience, self._most_s / self._least_s)

    def heard(self) -> None:
        """The link works: what was missed was lost, and not late."""
        self._patience = 1.0
