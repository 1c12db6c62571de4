"""Numbers of new resources: each is greater than the one before, and pages of lists are cut by them."""

from __future__ import annotations

from skyfolio.api.common.surroundings import new_token, utc_s

_SLOT_BITS = 10


class Numbers:
    """Gives the numbers of one kind of resource.

    last: the greatest number that is stored. several: whether other services give numbers for the same table. Then a
    number is the millisecond in which it is given, and ten bits that differ from service to service: the newest
    resource of all services has the greatest number, and no service needs to ask another.
    """

    def __init__(self, last: int = 0, *, several: bool = False) -> None:
        self._last, self._several = last, several
        self._slot = int(new_token(2), 16) % (1 << _SLOT_BITS) if several else 0

    def next(self) -> int:
        """Return the next number."""
        if self._several:
            by_time = int(utc_s() * 1e3) << _SLOT_BITS | self._slot
            self._last = by_time if by_time > self._last else self._last + (1 << _SLOT_BITS)
        else:
            self._last += 1
        return self._last
