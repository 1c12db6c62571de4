"""Cut bytes into MAVLink frames: where a frame begins and ends, who sent it, and to whom it goes.

Payloads are left alone: MAVSDK reads them. Frames of messages this dialect knows are only taken with a right checksum.
Layout (MAVLink 2): 0xFD, length, incompat flags, compat flags, seq, system, component, message id (3 bytes, little
endian), payload, checksum (2 bytes), and 13 bytes of signature if incompat flag 1 is set.
"""

from __future__ import annotations

import struct
from collections.abc import Hashable
from functools import cache
from typing import NamedTuple

from fastcrc import crc16
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge.autopilots import speaks_as_autopilot

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
HEADER = 10
_HEADER_V1 = 6
_CHECKSUM = 2
_HEARTBEAT, _MAV_TYPE, _MAV_AUTOPILOT = 0, 4, 5
"""The number of HEARTBEAT, and the offsets of its type and autopilot in the payload."""
_AUTOPILOT = 1
SIGNATURE = 13


class Frame(NamedTuple):
    """One frame as it was received.

    `target` is the system it addresses, 0 for all; `source`: the address it was sent from, None on a link with one
    other end.
    """

    data: bytes
    system_id: int
    component_id: int
    message_id: int
    seq: int
    version: int
    signed: bool
    source: Hashable = None

    @property
    def target(self) -> int:
        """Return the system id in the payload; 0 if the message has none."""
        offset = _target_offset(self.message_id)
        header = HEADER if self.version == 2 else _HEADER_V1
        if offset is None or offset >= self.data[1]:  # trailing zeros are not sent
            return 0
        return self.data[header + offset]


class Framer:
    """Cuts a byte stream into frames; bytes between frames and damaged frames are skipped and counted in `damaged`.

    source: the address that the bytes come from.
    """

    def __init__(self, source: Hashable = None) -> None:
        self.damaged = 0
        self._source = source
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that `data` completes."""
        buffer = self._rest + data if self._rest else data
        frames: list[Frame] = []
        at = 0
        while at < len(buffer):
            if buffer[at] not in (V1, V2):
                at = _next_marker(buffer, at)
                continue
            length = _frame_length(buffer, at)
            if length is None or at + length > len(buffer):
                break
            frame = _frame(buffer[at : at + length], self._source)
            if frame is None:
                self.damaged += 1
                at += 1
                continue
            frames.append(frame)
            at += length
        self._rest = buffer[at:]
        return frames


def checksum(data: bytes, message_id: int) -> int | None:
    """Return the X.25 checksum of a frame's bytes after the marker, with the message's seed; None if it is unknown."""
    seed = _seed(message_id)
    return None if seed is None else int(crc16.mcrf4xx(data + bytes((seed,))))


def _next_marker(buffer: bytes, at: int) -> int:
    places = [place for place in (buffer.find(V1, at), buffer.find(V2, at)) if place >= 0]
    return min(places, default=len(buffer))


def _frame_length(buffer: bytes, at: int) -> int | None:
    """Return the length in bytes of the frame that begins here, None if its header is incomplete."""
    if buffer[at] == V1:
        return None if at + 2 > len(buffer) else _HEADER_V1 + buffer[at + 1] + _CHECKSUM
    if at + 3 > len(buffer):
        return None
    return HEADER + buffer[at + 1] + _CHECKSUM + (SIGNATURE if buffer[at + 2] & SIGNED else 0)


def _frame(data: bytes, source: Hashable) -> Frame | None:
    """Return the frame in these bytes, None if it is damaged."""
    if data[0] == V1:
        _, length, seq, system, component, message = data[:_HEADER_V1]
        header, version, signed = _HEADER_V1, 1, False
    else:
        _, length, flags, _, seq, system, component = data[:7]
        message = int.from_bytes(data[7:HEADER], "little")
        header, version, signed = HEADER, 2, bool(flags & SIGNED)
        if flags & ~SIGNED:
            return None
    end = header + length
    right = checksum(data[1:end], message)
    if right is not None and right != int.from_bytes(data[end : end + _CHECKSUM], "little"):
        return None
    return Frame(data, system, component, message, seq, version, signed, source)


def is_foreign_heartbeat(frame: Frame) -> bool:
    """Return whether it is a HEARTBEAT that claims to be an autopilot's (component 1) and is not."""
    if frame.message_id != _HEARTBEAT or frame.component_id != _AUTOPILOT:
        return False
    header = HEADER if frame.version == 2 else _HEADER_V1
    payload = frame.data[header : header + frame.data[1]].ljust(
        _MAV_AUTOPILOT + 1, b"\0"
    )  # zeros at its end are not sent
    return not speaks_as_autopilot(payload[_MAV_TYPE], payload[_MAV_AUTOPILOT])


@cache
def _seed(message_id: int) -> int | None:
    message = dialect.mavlink_map.get(message_id)
    return None if message is None else int(message.crc_extra)


@cache
def _target_offset(message_id: int) -> int | None:
    """Return the offset of `target_system` in the payload: fields are sent in the order of `ordered_fieldnames`."""
    message = dialect.mavlink_map.get(message_id)
    if message is None or "target_system" not in message.ordered_fieldnames:
        return None
    offset = 0
    for name in message.ordered_fieldnames:
        if name == "target_system":
            return offset
        place = message.fieldnames.index(name)
        size = struct.calcsize("<" + _FORMATS[message.fieldtypes[place]])
        offset += size * max(1, message.array_lengths[message.ordered_fieldnames.index(name)])
    return None


_FORMATS = {
    "char": "b",
    "uint8_t": "B",
    "int8_t": "b",
    "uint16_t": "H",
    "int16_t": "h",
    "uint32_t": "I",
    "int32_t": "i",
    "uint64_t": "Q",
    "int64_t": "q",
    "float": "f",
    "double": "d",
}
