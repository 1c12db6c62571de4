"""What one flight has to know of the air around it. Metres east/north of its scenario's origin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.mavlink_bridge.corridors import Corridor
from skyfolio.planner.geometry import Point


class Traffic(Protocol):
    """The other aircraft of the service as one flight sees them, and its own air."""

    owner: str
    """Names this flight in messages about its air."""

    def others(self) -> list[Corridor]:
        """Return the corridors of UAVs that fly for other operations, or for none, and are heard."""

    def corridor(
        self, uav: str, level_m: Sequence[Point], altitudes: Altitudes | None, *, climbs: bool = False
    ) -> Corridor:
        """Return the air of a UAV of this flight that flies this line and then descends.

        level_m: metres east/north. altitudes: None if it descends from where it is. climbs: it climbs
        at the first point of the line.
        """
