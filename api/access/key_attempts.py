"""Rate limit of wrong keys: each address may try some per minute, and is refused after that.

An operator must always be able to act. A key that was valid from an address before is still accepted from it while
someone else there, for example behind the same router or proxy, tries wrong ones.
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
"""Pairs of address and key that are remembered as valid."""
V6_NETWORK = 64
"""Bits of an IPv6 address that its owner does not choose."""


class KeyAuthenticator:
    """Identifies API keys, and limits the wrong ones that an address may try."""

    def __init__(self, keys: KeyRing, per_minute: int) -> None:
        self._keys = keys
        self._limit = RateLimitItemPerMinute(per_minute)
        self._limiter = MovingWindowRateLimiter(MemoryStorage())
        self._known: OrderedDict[tuple[str, bytes], None] = OrderedDict()

    async def identify(self, client: str, key: str) -> Principal | None:
        """Return whose key this is, None for one that is unknown or revoked. Raises TooManyRequestsError."""
        network = _network(client)
        known = (network, sha256(key.encode("utf-8", "replace")).digest())
        if known not in self._known and not self._limiter.test(self._limit, network):
            wait_s = self._limiter.get_window_stats(self._limit, network).reset_time - time.time()
            raise TooManyRequestsError(
                f"Authorization: more than {self._limit.amount} wrong keys a minute from this address", wait_s
            )
        principal = await self._keys.identify(key)
        if principal is None:
            self._known.pop(known, None)
            self._limiter.hit(self._limit, network)
            return None
        self._known[known] = None
        self._known.move_to_end(known)
        if len(self._known) > MOST_KNOWN:
            self._known.popitem(last=False)
        return principal


def _network(client: str) -> str:
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return client
    return client if address.version == 4 else str(ipaddress.ip_network((address, V6_NETWORK), strict=False))
