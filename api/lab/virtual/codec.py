"""MAVLink 2 frames of messages, and messages of frames, as fast as Python does it.

Field names, types and checksum seeds are those of pymavlink's dialect; extension fields that it does not have yet are
added here. A message is a name and its fields: text for characters, lists for arrays, None for NaN.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import cache
from math import isnan
from typing import Any, NamedTuple

from fastcrc import crc16
from pymavlink.dialects.v20 import ardupilotmega as dialect

MARKER, HEADER, CHECKSUM = 0xFD, 10, 2
_LETTERS = {
    "int8_t": "b",
    "uint8_t": "B",
    "uint8_t_mavlink_version": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
}
_NEW_FIELDS = {
    "MISSION_CURRENT": (("mission_id", "I"), ("fence_id", "I"), ("rally_points_id", "I")),
    "MISSION_ACK": (("opaque_id", "I"),),
    "MISSION_COUNT": (("opaque_id", "I"),),
}
"""Extension fields of the standard that the dialect does not have yet, in wire order."""


class Field(NamedTuple):
    """One field. `values`: how many values it takes in the struct; `text`: whether they are characters."""

    name: str
    values: int
    text: bool
    real: bool


class Layout(NamedTuple):
    """How one message is laid out."""

    name: str
    number: int
    seed: int
    struct: struct.Struct
    fields: tuple[Field, ...]
    plain: bool
    """Whether each field is one number."""
    names: tuple[str, ...]
    reals: tuple[int, ...]
    """Where the fields that may be NaN are."""


class Decoded(NamedTuple):
    """A message that was received."""

    system_id: int
    component_id: int
    name: str
    fields: dict[str, Any]


@cache
def layout_of(number: int) -> Layout | None:
    """Return the layout of a message by its id; None for one that the dialect does not know."""
    message = dialect.mavlink_map.get(number)
    if message is None:
        return None
    name = str(message.msgname)
    letters, fields = "<", []
    for place, field in enumerate(message.ordered_fieldnames):
        kind = message.fieldtypes[message.fieldnames.index(field)]
        length = message.array_lengths[place]
        if kind == "char":
            letters += f"{max(1, length)}s"
            fields.append(Field(field, 1, text=True, real=False))
        else:
            letters += f"{max(1, length)}{_LETTERS[kind]}"
            fields.append(Field(field, max(1, length), text=False, real=kind in {"float", "double"}))
    for field, letter in _NEW_FIELDS.get(name, ()):
        letters += letter
        fields.append(Field(field, 1, text=False, real=False))
    plain = all(field.values == 1 and not field.text for field in fields)
    return Layout(
        name=name,
        number=number,
        seed=int(message.crc_extra),
        struct=struct.Struct(letters),
        fields=tuple(fields),
        plain=plain,
        names=tuple(field.name for field in fields),
        reals=tuple(place for place, field in enumerate(fields) if field.real),
    )


@cache
def number_of(name: str) -> int:
    """Return the id of a message. KeyError for one that the dialect does not know."""
    return _numbers()[name]


@cache
def _numbers() -> dict[str, int]:
    return {str(message.msgname): number for number, message in dialect.mavlink_map.items()}


def decode(data: bytes) -> list[Decoded]:
    """Return the messages of whole MAVLink 2 frames in a row whose checksums are right; unknown ones are left out."""
    found, at = [], 0
    while at + HEADER + CHECKSUM <= len(data):
        length, number = data[at + 1], int.from_bytes(data[at + 7 : at + HEADER], "little")
        layout = layout_of(number)
        if layout is not None:
            payload = data[at + HEADER : at + HEADER + length].ljust(layout.struct.size, b"\0")
            fields = _fields(layout, layout.struct.unpack_from(payload))
            found.append(Decoded(data[at + 5], data[at + 6], layout.name, fields))
        at += HEADER + length + CHECKSUM
    return found


def _fields(layout: Layout, values: tuple[Any, ...]) -> dict[str, Any]:
    if layout.plain:
        fields = dict(zip(layout.names, values, strict=True))
        for place in layout.reals:
            if isnan(values[place]):
                fields[layout.names[place]] = None
        return fields
    fields, at = {}, 0
    for name, count, text, real in layout.fields:
        part = values[at : at + count]
        at += count
        if text:
            fields[name] = part[0].partition(b"\0")[0].decode("ascii", "replace")
        else:
            shown = [None if real and isnan(value) else value for value in part]
            fields[name] = shown if count > 1 else shown[0]
    return fields


def encode(name: str, fields: Mapping[str, Any], *, sender: tuple[int, int], seq: int) -> bytes:
    """Return the frame of a message. Fields that are not given are 0. KeyError for an unknown message or field."""
    layout = layout_of(number_of(name))
    assert layout is not None  # noqa: S101 - it has a number
    unknown = fields.keys() - set(layout.names)
    if unknown:
        raise KeyError(f"{name} has no field {', '.join(sorted(unknown))}")
    values: list[Any] = []
    for field in layout.fields:
        value = fields.get(field.name, b"" if field.text else 0)
        if field.text:
            values.append(value.encode() if isinstance(value, str) else value)
        elif field.values > 1:
            given = [*(value or ())]
            values += [_number(one, field) for one in given] + [0] * (field.values - len(given))
        else:
            values.append(_number(value, field))
    payload = layout.struct.pack(*values).rstrip(b"\0") or b"\0"
    head = struct.pack("<BBBBBB", len(payload), 0, 0, seq % 256, *sender) + layout.number.to_bytes(3, "little")
    check = crc16.mcrf4xx(head + payload + bytes((layout.seed,)))
    return bytes((MARKER,)) + head + payload + struct.pack("<H", check)


def _number(value: Any, field: Field) -> Any:
    if field.real:
        return float("nan") if value is None else value
    return int(value)
