"""Making a resource once: what an `Idempotency-Key` promises, also across a crash.

The id of a keyed resource is a digest of who asks, where, and the key. The resource itself is thus the memory of the
request: it is stored in one step with what it remembers, and no crash can fall between the two.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from hashlib import sha256

from skyfolio.api.common.errors import InvalidError


@dataclass(frozen=True, kw_only=True)
class Creation:
    """Id and owner of a resource to be made; `fingerprint` is the digest of a keyed request, None without a key."""

    id: str
    owner: str = "service"
    fingerprint: str | None = None

    def require_same(self, fingerprint: str | None) -> None:
        """Raises InvalidError when the key was used for another request."""
        if fingerprint != self.fingerprint:
            raise InvalidError("Idempotency-Key: was used before for a different request")


def fresh(prefix: str, owner: str = "service") -> Creation:
    """A resource that is new whatever happens."""
    return Creation(id=f"{prefix}-{secrets.token_hex(6)}", owner=owner)


def keyed(prefix: str, owner: str, key: str, path: str, request: bytes) -> Creation:
    """A resource that the same owner makes once for the same key and path."""
    digest = sha256("\0".join((owner, path, key)).encode()).hexdigest()
    return Creation(id=f"{prefix}-{digest[:20]}", owner=owner, fingerprint=sha256(request).hexdigest())
