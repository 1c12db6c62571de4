"""Creating a resource once: what an `Idempotency-Key` promises, also across a crash.

The id of a keyed resource is a digest of the principal, the path and the key. The resource itself is thus the record of
the request: both are stored in one step, and no crash can fall between the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.surroundings import new_token


@dataclass(frozen=True, kw_only=True)
class NewResource:
    """Id and owner of a resource to be created; `fingerprint` is the digest of a keyed request, None without a key."""

    id: str
    owner: str = "service"
    fingerprint: str | None = None

    def require_same(self, fingerprint: str | None) -> None:
        """Refuse a key that was used for another request. Raises InvalidError."""
        if fingerprint != self.fingerprint:
            raise InvalidError("Idempotency-Key: was used before for a different request")


def fresh(prefix: str, owner: str = "service") -> NewResource:
    """Return the identity of a resource that is new in any case."""
    return NewResource(id=f"{prefix}-{new_token(6)}", owner=owner)


def keyed(prefix: str, owner: str, key: str, path: str, request: bytes) -> NewResource:
    """Return the identity of a resource that the same owner creates once for the same key and path."""
    digest = sha256("\0".join((owner, path, key)).encode()).hexdigest()
    return NewResource(id=f"{prefix}-{digest[:20]}", owner=owner, fingerprint=sha256(request).hexdigest())
