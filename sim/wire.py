"""The MAVLink 2 messages on the wire: pymavlink's dialect, plus the extension fields that it does not have yet.

pymavlink 2.4.50 leaves out `mission_id` (MISSION_CURRENT) and `opaque_id` (MISSION_ACK, MISSION_COUNT). Extension
fields are not part of a message's checksum seed, so they can be appended to the payload of its message.
"""

import struct
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple, Protocol

from fastcrc import crc16
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.signing import Signature, SignedMavlink

AUTOPILOT_COMPONENT = 1
MAVLINK_2_MARKER = 0xFD
MESSAGE_NAMES = frozenset(message.msgname for message in dialect.mavlink_map.values())
"""The names of all messages of the dialect."""


class Message(Protocol):
    """An outgoing message: has a name, and packs itself with a sender's identity."""

    def pack(self, mav: Any) -> bytes:
        """Return the frame, with `mav`'s system id, component id and sequence number."""
        ...

    def get_type(self) -> str:
        """Return the message name, e.g. "HEARTBEAT"."""
        ...

    def __getattr__(self, name: str) -> Any:
        """Return a field."""
        ...


class Extended:
    """A message without array fields, with `<name>: uint32` extension fields appended to its payload."""

    def __init__(self, base: Any, **extension: int) -> None:
        self.base = base
        self.extension = extension

    def __getattr__(self, name: str) -> Any:
        """Return an extension field, or a field of the base message."""
        if name in self.extension:
            return self.extension[name]
        return getattr(self.base, name)

    def get_type(self) -> str:
        """Return the message name."""
        return str(self.base.get_type())

    def pack(self, mav: Any) -> bytes:
        """Return the frame."""
        base = self.base
        payload = base.unpacker.pack(*(getattr(base, name) for name in base.ordered_fieldnames)) + self.extension_bytes
        return bytes(base._pack(mav, base.crc_extra, payload))

    @property
    def extension_bytes(self) -> bytes:
        """Return the extension fields as they are sent."""
        return struct.pack(f"<{len(self.extension)}I", *self.extension.values())


class Unlisted:
    """A message that pymavlink does not have, built from its definition.

    `fields` are the types and names in wire order, as the checksum seed has them; a last array field has `array_bytes`.
    """

    def __init__(
        self, message_id: int, name: str, fields: str, layout: str, values: tuple[Any, ...], *, array_bytes: int = 0
    ) -> None:
        self._message = dialect.MAVLink_message(message_id, name)
        self._name = name
        self._payload = struct.pack(layout, *values)
        self.values = values
        seed = mavutil.x25crc(f"{name} {fields}".encode() + (bytes([array_bytes]) if array_bytes else b""))
        self._crc_extra = seed.crc & 0xFF ^ seed.crc >> 8

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError: the fields are in `values`."""
        raise AttributeError(name)

    def get_type(self) -> str:
        """Return the message name."""
        return self._name

    def pack(self, mav: Any) -> bytes:
        """Return the frame."""
        return bytes(self._message._pack(mav, self._crc_extra, self._payload))


class Encoder:
    """Packs messages as component 1 of one system, numbers them, and signs them if there is a key."""

    def __init__(self, system_id: int, signature: Signature | None = None) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=AUTOPILOT_COMPONENT)
        self._signature = signature
        if signature is not None:
            signature.apply(self._mav, outgoing=True)

    def encode(self, message: Message) -> bytes:
        """Return the MAVLink 2 frame of `message`."""
        mav = self._mav
        if self._signature is not None:
            mav.signing.timestamp = max(mav.signing.timestamp, self._signature.timestamp)
            frame = message.pack(mav)
        else:
            frame = _plain_frame(message, mav) or message.pack(mav)
        mav.seq = (mav.seq + 1) % 256
        return frame


class _Layout(NamedTuple):
    """How a message without arrays is laid out: its number, how its fields are read and packed, and its seed."""

    number: bytes
    values: Callable[[Any], tuple[Any, ...]]
    pack: Callable[..., bytes]
    seed: bytes


@cache
def _layout_of(kind: Any) -> _Layout | None:
    """Return the layout of a class of messages; None for one that has arrays, or packs itself in its own way."""
    if not issubclass(kind, dialect.MAVLink_message) or any(kind.array_lengths):
        return None
    names = kind.ordered_fieldnames
    values = attrgetter(*names) if len(names) > 1 else lambda message, only=attrgetter(*names): (only(message),)
    return _Layout(kind.id.to_bytes(3, "little"), values, kind.unpacker.pack, bytes((kind.crc_extra,)))


def _plain_frame(message: Any, mav: Any) -> bytes | None:
    """Return the unsigned frame of a message, as pymavlink packs it, in a fraction of the time; None if it has to."""
    extended = type(message) is Extended
    base = message.base if extended else message
    layout = _layout_of(base.__class__)
    if layout is None:
        return None
    payload = layout.pack(*layout.values(base))
    if extended:
        payload += message.extension_bytes
    payload = payload.rstrip(b"\0") or payload[:1]
    head = bytes((len(payload), 0, 0, mav.seq, mav.srcSystem, mav.srcComponent)) + layout.number
    checksum = crc16.mcrf4xx(head + payload + layout.seed)
    return b"%c%b%b%b" % (MAVLINK_2_MARKER, head, payload, checksum.to_bytes(2, "little"))


class Decoder:
    """Parses the byte stream of one peer; damaged and MAVLink 1 frames are dropped, and with a key unsigned ones."""

    def __init__(self, signature: Signature | None = None) -> None:
        self._mav = SignedMavlink(None)
        self._mav.robust_parsing = True
        if signature is not None:
            signature.apply(self._mav, outgoing=False)

    def decode(self, data: bytes) -> list[Any]:
        """Return the whole MAVLink 2 messages that `data` completes."""
        messages = self._mav.parse_buffer(data) or []
        return [message for message in messages if self._is_ours(message)]

    @staticmethod
    def _is_ours(message: Any) -> bool:
        name = message.get_type()
        return name != "BAD_DATA" and not name.startswith("UNKNOWN") and message.get_msgbuf()[0] == MAVLINK_2_MARKER


TEXT_BYTES = 50
"""The length of one STATUSTEXT."""


def texts(words: str, severity: int, number: int) -> list[Message]:
    """Return the STATUSTEXTs of all of `words`: one, or parts with the id `number` (1-65535) and a sequence number."""
    data = words.encode("ascii", "replace")
    if len(data) <= TEXT_BYTES:
        return [dialect.MAVLink_statustext_message(severity, data)]
    parts = [data[at : at + TEXT_BYTES] for at in range(0, len(data), TEXT_BYTES)]
    return [dialect.MAVLink_statustext_message(severity, part, number, at) for at, part in enumerate(parts)]


def text(words: str, severity: int = dialect.MAV_SEVERITY_INFO) -> Message:
    """Return a STATUSTEXT; words beyond 50 bytes are cut."""
    message: Message = dialect.MAVLink_statustext_message(severity, words.encode("ascii", "replace")[:TEXT_BYTES])
    return message
