"""The vocabulary of the mission protocol: types, results and messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from skyfolio.mavlink_bridge.answers import Ack

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
