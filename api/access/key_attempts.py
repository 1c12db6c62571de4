"""Trying keys: each address may try some wrong ones a minute, and is not listened to after that.

An operator must always be able to act. A key that was right from an address before goes on being taken from it,
also while somebody else there, behind the same router or proxy for one, tries wrong ones.
"""

from __future__ import annotations

import ipaddress
import time
from collections import OrderedDict
from hashlib import sha256

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter

from skyfolio.api.access.api_keys import KeyRing, Principal
from skyfolio.api.common.errors import TooManyRequestsError

MOST_KNOWN = 1_000
"""Addresses with their keys that are remembered as right."""
V6_NETWORK = 64
"""Bits of an IPv6 address that its owner does not choose."""


class Door:
    """Says whose key it is, and counts those that are nobody's."""

    def __init__(self, keys: KeyRing, per_minute: int) -> None:
        self._keys = keys
        self._limit = RateLimitItemPerMinute(per_minute)
        self._limiter = MovingWindowRateLimiter(MemoryStorage())
        self._known: OrderedDict[tuple[str, bytes], None] = OrderedDict()

    async def identify(self, client: str, key: str) -> Principal | None:
        """Whose key this is, None for one that is unknown or revoked. Raises TooManyRequestsError."""
        network = _network(client)
        known = (network, sha256(key.encode("utf-8", "replace")).digest())
        if known not in self._known and not self._limiter.test(self._limit, network):
            wait_s = self._limiter.get_window_stats(self._limit, network).reset_time - time.time()
            raise TooManyRequestsError(
                f"Authorization: more than {self._limit.amount} wrong keys a minute from this address", wait_s
            )
        found = await self._keys.identify(key)
        if found is None:
            self._known.pop(known, None)
            self._limiter.hit(self._limit, network)
            return None
        self._known[known] = None
        self._known.move_to_end(known)
        if len(self._known) > MOST_KNOWN:
            self._known.popitem(last=False)
        return found


def _network(client: str) -> str:
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return client
    return client if address.version == 4 else str(ipaddress.ip_network((address, V6_NETWORK), strict=False))
