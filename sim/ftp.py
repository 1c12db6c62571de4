"""MAVLink FTP, reading only: FILE_TRANSFER_PROTOCOL answers for a handful of files in memory.

Opcodes: open for reading, read, burst read, size and CRC on the way, list, terminate, reset. Writing is refused. One
session; a request that is received twice gets the same answer.
"""

import struct
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.wire import Message

DATA_BYTES = 239
_HEADER = struct.Struct("<HBBBBBBI")
TERMINATE, RESET, LIST, OPEN, READ, CRC, BURST = 1, 2, 3, 4, 5, 14, 15
_NONE, ACK, NAK = 0, 128, 129
_INVALID_SESSION, _END_OF_FILE, _UNKNOWN, _NOT_FOUND = 4, 6, 7, 10
_MOST_IN_A_BURST = 20


class Request(NamedTuple):
    """The payload of one FILE_TRANSFER_PROTOCOL message."""

    seq: int
    session: int
    opcode: int
    size: int
    request_opcode: int
    complete: int
    offset: int
    data: bytes

    @classmethod
    def unpack(cls, payload: bytes) -> "Request":
        """Return the request in a payload of 251 bytes."""
        seq, session, opcode, size, request_opcode, complete, _, offset = _HEADER.unpack_from(payload)
        data = bytes(payload[_HEADER.size : _HEADER.size + min(size, DATA_BYTES)])
        return cls(seq, session, opcode, size, request_opcode, complete, offset, data)

    @property
    def path(self) -> str:
        """The path that the data holds."""
        return self.data.rstrip(b"\0").decode("ascii", "replace")


class FileServer:
    """Serves `files` (path to content) to any ground station."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self._files = {path.lstrip("/"): content for path, content in files.items()}
        self._open: bytes | None = None

    def handle(self, message: Any) -> list[Message]:
        """Return the answers to a FILE_TRANSFER_PROTOCOL message."""
        request = Request.unpack(bytes(message.payload))
        partner = (message.target_network, message.get_srcSystem(), message.get_srcComponent())
        return [
            dialect.MAVLink_file_transfer_protocol_message(*partner, list(payload))
            for payload in self._answers(request)
        ]

    def _answers(self, request: Request) -> list[bytes]:
        if request.opcode == OPEN:
            return [self._opened(request)]
        if request.opcode in (READ, BURST):
            return self._read(request)
        if request.opcode == CRC:
            content = self._files.get(request.path.lstrip("/"))
            return [_nak(request, _NOT_FOUND) if content is None else _ack(request, struct.pack("<I", crc32(content)))]
        if request.opcode == LIST:
            return [self._listed(request)]
        if request.opcode in (TERMINATE, RESET):
            self._open = None
            return [_ack(request)]
        return [] if request.opcode in (_NONE, ACK, NAK) else [_nak(request, _UNKNOWN)]

    def _opened(self, request: Request) -> bytes:
        content = self._files.get(request.path.lstrip("/"))
        if content is None:
            return _nak(request, _NOT_FOUND)
        self._open = content
        return _ack(request, struct.pack("<I", len(content)))

    def _read(self, request: Request) -> list[bytes]:
        if self._open is None:
            return [_nak(request, _INVALID_SESSION)]
        size = min(request.size or DATA_BYTES, DATA_BYTES)
        most = _MOST_IN_A_BURST if request.opcode == BURST else 1
        offsets = range(request.offset, min(len(self._open), request.offset + most * size), size)
        answers = []
        for number, offset in enumerate(offsets):
            last = number == most - 1 or offset + size >= len(self._open)
            chunk = self._open[offset : offset + size]
            answers.append(_ack(request, chunk, seq=number + 1, offset=offset, complete=int(last and most > 1)))
        return answers or [_nak(request, _END_OF_FILE)]

    def _listed(self, request: Request) -> bytes:
        folder = request.path.strip("/")
        entries = [
            f"F{path[len(folder) :].lstrip('/')}\t{len(content)}"
            for path, content in sorted(self._files.items())
            if path.startswith(folder)
        ][request.offset :]
        data = "\0".join(entries).encode() + b"\0"
        return _ack(request, data[:DATA_BYTES]) if entries else _nak(request, _END_OF_FILE)


def crc32(content: bytes) -> int:
    """Return the CRC-32 MAVLink FTP uses: no inversion before or after."""
    return zlib.crc32(content, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _ack(request: Request, data: bytes = b"", *, seq: int = 1, offset: int | None = None, complete: int = 0) -> bytes:
    at = request.offset if offset is None else offset
    head = _HEADER.pack((request.seq + seq) & 0xFFFF, 0, ACK, len(data), request.opcode, complete, 0, at)
    return (head + data).ljust(_HEADER.size + DATA_BYTES, b"\0")


def _nak(request: Request, error: int) -> bytes:
    head = _HEADER.pack((request.seq + 1) & 0xFFFF, 0, NAK, 1, request.opcode, 0, 0, request.offset)
    return (head + bytes([error])).ljust(_HEADER.size + DATA_BYTES, b"\0")
