"""MAVLink 2 message signing, both ways, between MAVSDK (which has none) and the links.

A signature is link id (1 byte), timestamp (6 bytes, 10 microseconds since 2015-01-01) and the first 6 bytes of
SHA-256(key + frame + link id + timestamp); https://mavlink.io/en/guide/message_signing.html.

pymavlink 2.4.50 stores a stream's timestamp before it compares the hash: one forged frame from the far future shuts out
every genuine one after it. `_Checked` compares first. MAVLink 1 and unsigned frames are never accepted.
"""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable
from pathlib import Path

from pydantic import SecretBytes
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge.errors import SigningKeyInvalid
from skyfolio.mavlink_bridge.framing import HEADER, SIGNATURE, SIGNED, V2, Frame, checksum

KEY_BYTES = 32
_EPOCH_2015_S = 1420070400
_PER_SECOND = 100_000
_HASH_BYTES = 6
_BEHIND = 60 * _PER_SECOND
"""A stream heard for the first time may be this far behind our clock."""


class _Checked(dialect.MAVLink):  # type: ignore[misc]
    """pymavlink's parser with a safe order of checks: nothing of a frame with a wrong signature is stored."""

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        """Return whether a frame is genuine and newer than the last of its stream (link id, system, component)."""
        digest = hashlib.sha256(bytes(self.signing.secret_key) + bytes(msgbuf[:-_HASH_BYTES])).digest()
        if not hmac.compare_digest(digest[:_HASH_BYTES], bytes(msgbuf[-_HASH_BYTES:])):
            return False
        timestamp = int.from_bytes(msgbuf[-12:-_HASH_BYTES], "little")
        stream = (msgbuf[-SIGNATURE], srcSystem, srcComponent)
        last = self.signing.stream_timestamps.get(stream)
        if timestamp <= last if last is not None else timestamp + _BEHIND < self.signing.timestamp:
            return False
        self.signing.stream_timestamps[stream] = timestamp
        self.signing.timestamp = max(self.signing.timestamp, timestamp)
        return True


class Signing:
    """Signs what is sent and accepts only what is signed with the same key.

    `wall_s` returns seconds since 1970. The key never appears in a message, a log or a repr. Raises SigningKeyInvalid.
    """

    def __init__(self, key: bytes | SecretBytes, *, link_id: int = 0, wall_s: Callable[[], float] = time.time) -> None:
        secret = key.get_secret_value() if isinstance(key, SecretBytes) else key
        if len(secret) != KEY_BYTES:
            raise SigningKeyInvalid(f"{len(secret)} bytes, must be {KEY_BYTES}")
        self.refused = 0
        """The number of frames dropped because they were MAVLink 1, unsigned, forged or replayed."""
        self._wall_s = wall_s
        self._mav = _Checked(None)
        self._mav.signing.secret_key = secret
        self._mav.signing.link_id = link_id
        self._mav.signing.timestamp = self._now()

    @classmethod
    def from_file(cls, path: Path, *, link_id: int = 0) -> Signing:
        """Return the signing with the key in a file: 32 raw bytes, or 64 hexadecimal digits.

        Raises SigningKeyInvalid.
        """
        try:
            content = path.read_bytes()
            key = content if len(content) == KEY_BYTES else bytes.fromhex(content.decode().strip())
        except (OSError, ValueError) as error:
            raise SigningKeyInvalid(f"{path} cannot be read as a key ({type(error).__name__})") from None
        return cls(key, link_id=link_id)

    def sign(self, frame: bytes) -> bytes:
        """Return a MAVLink 2 frame with our signature. Raises ValueError for anything that cannot be signed."""
        message_id = int.from_bytes(frame[7:HEADER], "little")
        bare = _with_flag(frame, message_id, signed=True)
        if bare is None:
            raise ValueError(f"frame: message {message_id} is not one this dialect can sign")
        signing = self._mav.signing
        signing.timestamp = max(signing.timestamp + 1, self._now())
        tail = bytes((signing.link_id,)) + int(signing.timestamp).to_bytes(6, "little")
        digest = hashlib.sha256(signing.secret_key + bare + tail).digest()
        return bare + tail + digest[:_HASH_BYTES]

    def accept(self, frame: Frame) -> bytes | None:
        """Return the frame without its signature if it is genuine, None if it must be dropped."""
        genuine = (
            frame.version == 2
            and frame.signed
            and self._mav.check_signature(bytearray(frame.data), frame.system_id, frame.component_id)
        )
        bare = _with_flag(frame.data[:-SIGNATURE], frame.message_id, signed=False) if genuine else None
        if bare is None:
            self.refused += 1
        return bare

    def _now(self) -> int:
        return int((self._wall_s() - _EPOCH_2015_S) * _PER_SECOND)


def _with_flag(frame: bytes, message_id: int, *, signed: bool) -> bytes | None:
    """Return the frame (without signature) with incompat flag 1 set or cleared and its checksum made right."""
    if len(frame) < HEADER + 2 or frame[0] != V2:
        return None
    flags = frame[2] | SIGNED if signed else frame[2] & ~SIGNED
    body = frame[1:2] + bytes((flags,)) + frame[3:-2]
    right = checksum(body, message_id)
    return None if right is None else bytes((V2,)) + body + right.to_bytes(2, "little")
