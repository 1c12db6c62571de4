"""The base station that a vehicle carries: it serves only what it has acknowledged, and only while that is valid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Served:
    """Users, and the band of each in Hz, from and until these fleet seconds. sends: whether it sends at all then."""

    from_s: float
    until_s: float
    bandwidth_hz: Mapping[str, float]
    sends: bool = True


@dataclass(frozen=True, slots=True)
class _Order:
    """What it was ordered to serve, and when it will be ready to."""

    revision: int
    ready_s: float
    slots: tuple[Served, ...]


class BaseStation:
    """Receives orders, acknowledges them, and serves by the newest that it has acknowledged.

    power_db: how much more it sends than it was built for. jam_db: how much more noise its users receive. late_s: how
    long it takes to get ready for an order. deaf: whether it receives none.
    """

    def __init__(self) -> None:
        self.power_db = 0.0
        self.jam_db = 0.0
        self.late_s = 0.0
        self.deaf = False
        self._heard: _Order | None = None
        self._serves: _Order | None = None

    def join(self) -> None:
        """Serve no user, and wait for orders of another operation, whose revisions begin anew."""
        self._heard = self._serves = None

    def hear(self, revision: int, slots: Sequence[Served], now_s: float) -> None:
        """Take an order of a revision, or not, if it is deaf; it replaces an older one that it was not ready for."""
        if self.deaf or (self._heard is not None and revision <= self._heard.revision):
            return
        self._heard = _Order(revision, now_s + self.late_s, tuple(slots))

    def ready(self, now_s: float) -> int | None:
        """Return the revision that it is ready to serve and has not acknowledged yet; None if there is none."""
        heard = self._heard
        if self.deaf or heard is None or now_s < heard.ready_s:
            return None
        done = -math.inf if self._serves is None else self._serves.revision
        return heard.revision if heard.revision > done else None

    def acknowledge(self, revision: int) -> None:
        """Serve by this revision from now on: it was acknowledged, and that was accepted."""
        if self._heard is not None and self._heard.revision == revision:
            self._serves = self._heard

    def serves(self, now_s: float) -> dict[str, float]:
        """Return the users that it serves now, and the band of each in Hz."""
        slot = self._slot(now_s)
        return {} if slot is None else dict(slot.bandwidth_hz)

    def sends(self, now_s: float) -> bool:
        """Return whether it sends now: always, unless what it has acknowledged tells it to be silent."""
        slot = self._slot(now_s)
        return slot is None or slot.sends

    def _slot(self, now_s: float) -> Served | None:
        slots = () if self._serves is None else self._serves.slots
        return next((slot for slot in slots if slot.from_s <= now_s < slot.until_s), None)
