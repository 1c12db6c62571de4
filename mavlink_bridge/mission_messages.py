"""The vocabulary of the mission protocol: types, results and messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from skyfolio.mavlink_bridge.answers import Ack

GROUND = (245, 190)
"""System and component id of MAVSDK's ground station: our own on the link."""
AUTOPILOT_COMPONENT = 1
SILENCE_S = 3.0
"""A transfer in which nothing was received for this long has failed (PX4 gives up after 5 s, ArduPilot after 8 s)."""


class MissionType(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


PASSING = frozenset({Ack.ERROR, Ack.DENIED, Ack.OPERATION_CANCELLED, Ack.INVALID_SEQUENCE})
"""Answers that another try may change: another transfer, a time-out, a confusion about which item is next."""


class Message(NamedTuple):
    """One outgoing message, fields as named in the MAVLink definition."""

    name: str
    fields: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a transfer ended. `error` None: complete. `opaque_id`: the checksum the vehicle reported, 0 if none.

    `passing`: another try may help. `perhaps_done`: everything was sent, only the final acknowledgement is missing.
    `busy`: it was refused before it began, by a vehicle that is in another transfer.
    """

    error: str | None = None
    passing: bool = True
    perhaps_done: bool = False
    busy: bool = False
    opaque_id: int = 0
