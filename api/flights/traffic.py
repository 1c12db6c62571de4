"""What one flight has to know of the air around it. Metres east/north of its origin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from skyfolio.api.flights.rates import Point
from skyfolio.mavlink_bridge.corridors import Corridor


class Traffic(Protocol):
    """The other aircraft of the service, as one flight sees them, and its own air."""

    owner: str
    """Names this flight in what is said of it."""

    def others(self) -> list[Corridor]:
        """Return the corridors of those who fly for other operations, or for none, and are heard."""

    def corridor(
        self, uav: str, level_m: Sequence[Point], altitude_m: float | None, *, climbs: bool = False
    ) -> Corridor:
        """Return the air of a UAV of this flight that flies this line at that altitude above its home, then descends.

        climbs: it climbs at the first point. Without an altitude it descends from where it is.
        """
