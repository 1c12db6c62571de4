"""Signatures of deliveries: HMAC-SHA256 (RFC 2104) over the time and the body, so that old ones cannot be replayed."""

from __future__ import annotations

import hmac
from hashlib import sha256

TIMESTAMP, SIGNATURE, DELIVERY = "Skyfolio-Timestamp", "Skyfolio-Signature", "Skyfolio-Delivery"


def signature(secret: str, timestamp: str, body: bytes) -> str:
    """Return the value of `Skyfolio-Signature`: `v1=` and the hexadecimal HMAC of `timestamp.body`."""
    return "v1=" + hmac.new(secret.encode(), timestamp.encode() + b"." + body, sha256).hexdigest()


def headers_of(secret: str, delivery: str, timestamp: str, body: bytes) -> dict[str, str]:
    """Return the headers of a delivery. `delivery` is the same each time that it is sent."""
    return {
        "Content-Type": "application/json",
        DELIVERY: delivery,
        TIMESTAMP: timestamp,
        SIGNATURE: signature(secret, timestamp, body),
    }
