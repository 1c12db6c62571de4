"""Slip: how far a UAV is from its plan as a slot begins, and whether that is worth a word."""

from __future__ import annotations

from dataclasses import dataclass

OFF_CLOCK_S, OFF_WAY_M = 2.0, 2.0
"""A UAV that moves is off schedule when it is both so late, or early, and so far from its point."""
OFF_PLACE_M = 5.0
"""A UAV that should hover is off schedule when it is so far from its place."""


@dataclass(frozen=True, slots=True)
class Slip:
    """How far a UAV is from its plan when slot `slot` begins: metres, and if it moves seconds late (early: negative).

    late_s: None where the plan hovers (`route.MOVING_MPS`): a UAV in its place is then neither late nor early.
    """

    slot: int
    distance_m: float
    late_s: float | None

    @property
    def off_schedule(self) -> bool:
        """Return whether this is worth a word.

        A UAV that moves is a little late at the end of nearly every slot, and one that hovers is moved by wind and GPS.
        """
        if self.late_s is None:
            return self.distance_m >= OFF_PLACE_M
        return self.distance_m >= OFF_WAY_M and abs(self.late_s) >= OFF_CLOCK_S
