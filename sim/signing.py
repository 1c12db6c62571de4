"""MAVLink 2 signing: only messages signed with the shared key are accepted.

pymavlink 2.4.50 stores the time stamp of a frame before it compares the signature, so that one forged frame from the
far future shuts out every later genuine one. Here the signature is compared first.
"""

import hashlib
import hmac
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

SIGNING_EPOCH_S = 1_420_070_400
"""Signing counts 10 microseconds since 2015-01-01 UTC."""
KEY_BYTES = 32
_SIGNATURE_BYTES = 6


class Signature:
    """A shared key, and Unix time for the time stamps. ValueError unless the key has 32 bytes."""

    def __init__(self, key: bytes, unix_time: Callable[[], float]) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"a signing key must have {KEY_BYTES} bytes, got {len(key)}")
        self.key = key
        self._unix_time = unix_time

    @property
    def timestamp(self) -> int:
        """The time of now in a signature: units of 10 microseconds."""
        return int((self._unix_time() - SIGNING_EPOCH_S) * 1e5)

    def apply(self, mav: Any, *, outgoing: bool) -> None:
        """Let a MAVLink endpoint sign what it sends, or refuse messages that are not signed."""
        mav.signing.secret_key = self.key
        mav.signing.sign_outgoing = outgoing
        mav.signing.timestamp = self.timestamp


class SignedMavlink(dialect.MAVLink):  # type: ignore[misc]
    """pymavlink's endpoint, that compares the signature of a frame before it stores anything of it."""

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        """Return whether a frame is signed with our key and not older than the frames before."""
        frame = bytes(msgbuf)
        digest = hashlib.sha256(self.signing.secret_key + frame[:-_SIGNATURE_BYTES]).digest()
        if not hmac.compare_digest(digest[:_SIGNATURE_BYTES], frame[-_SIGNATURE_BYTES:]):
            return False
        return bool(super().check_signature(msgbuf, srcSystem, srcComponent))
