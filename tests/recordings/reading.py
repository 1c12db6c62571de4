"""Recorded flights as messages: `for heard in messages("ccc-kill-calm"): ...`; README.md says what happens in each.

A `.tlog` is a sequence of 8 bytes (big endian) of microseconds since 1970 and one MAVLink frame, compressed with xz.
"""

from __future__ import annotations

import lzma
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

FOLDER = Path(__file__).parent
NAMES = tuple(sorted(path.name.removesuffix(".tlog.xz") for path in FOLDER.glob("*.tlog.xz")))
"""The recordings, without folder and ending. The letters say who flies: `c` an ArduCopter, `p` a PX4."""
SERVICE = 245
"""System id of the service that flew the fleet; its component id is 190 (MAV_COMP_ID_MISSIONPLANNER)."""

_TIME_BYTES = 8
_HEADER_BYTES, _CHECKSUM_BYTES, _SIGNATURE_BYTES = 10, 2, 13
_MAGIC_V2, _SIGNED = 0xFD, 0x01
_NEWER = {
    "MISSION_CURRENT": (("mission_id", 6), ("fence_id", 10), ("rally_points_id", 14)),
    "MISSION_ACK": (("opaque_id", 4),),
    "MISSION_COUNT": (("opaque_id", 5),),
}
"""Extension fields (uint32, and where they begin in the payload) that pymavlink's dialects do not have yet."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message of a recording.

    `at_s`: seconds since the recording began. `system_id` and `component_id` are the sender's. `fields`: as MAVLink
    names them and pymavlink reads them (text as str without the zeros behind it). `frame`: its bytes on the wire.
    """

    at_s: float
    system_id: int
    component_id: int
    name: str
    fields: dict[str, Any]
    frame: bytes

    @property
    def from_service(self) -> bool:
        """Whether the service said it to a vehicle; otherwise a vehicle, or another ground station, said it."""
        return self.system_id == SERVICE


def messages(name: str) -> Iterator[Recorded]:
    """Every message of a recording, in the order in which it was heard or sent."""
    yield from _read(name)


def vehicles(name: str) -> tuple[int, ...]:
    """System ids of the vehicles (component 1 that sends HEARTBEAT) of a recording."""
    return tuple(
        sorted({heard.system_id for heard in _read(name) if heard.name == "HEARTBEAT" and heard.component_id == 1})
    )


@cache
def _read(name: str) -> tuple[Recorded, ...]:
    data = lzma.decompress((FOLDER / f"{name}.tlog.xz").read_bytes())
    decoder = mavlink.MAVLink(None)
    found: list[Recorded] = []
    at, began_us = 0, int.from_bytes(data[:_TIME_BYTES], "big")
    while at < len(data):
        us = int.from_bytes(data[at : at + _TIME_BYTES], "big")
        at += _TIME_BYTES
        length = _frame_bytes(data, at)
        frame = data[at : at + length]
        at += length
        message = decoder.decode(bytearray(frame))
        fields = {field: getattr(message, field) for field in message.get_fieldnames()}
        fields |= _newer_fields(message.get_type(), frame[_HEADER_BYTES : _HEADER_BYTES + frame[1]])
        found.append(
            Recorded(
                at_s=(us - began_us) / 1e6,
                system_id=message.get_srcSystem(),
                component_id=message.get_srcComponent(),
                name=message.get_type(),
                fields=fields,
                frame=frame,
            )
        )
    assert all(math.isfinite(heard.at_s) and heard.at_s >= 0 for heard in found)
    return tuple(found)


def _newer_fields(name: str, payload: bytes) -> dict[str, int]:
    """MAVLink 2 cuts zeros off the end of a payload: what is not there is 0."""
    return {field: int.from_bytes(payload[begin : begin + 4], "little") for field, begin in _NEWER.get(name, ())}


def _frame_bytes(data: bytes, at: int) -> int:
    """Length of the MAVLink 2 frame that begins there."""
    assert data[at] == _MAGIC_V2, f"no MAVLink 2 frame at byte {at}"
    signature = _SIGNATURE_BYTES if data[at + 2] & _SIGNED else 0
    return _HEADER_BYTES + data[at + 1] + _CHECKSUM_BYTES + signature
