"""A plan's path against the slot clock: where a UAV should be, and how long a way along the path is. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist

from skyfolio.mavlink_bridge.schedule import SAME_PLACE_M
from skyfolio.planner.geometry import Point, between

MOVING_MPS = 1.0
"""A leg flown more slowly than this is a hover. A GPS position is off by a metre or two, which is ten seconds at
0.2 m/s: seconds say something about a UAV that moves, and metres about every UAV."""


@dataclass(frozen=True, slots=True)
class Planned:
    """Where a UAV should be (metres east/north of the origin) and how it should move (m/s east/north)."""

    point_m: Point
    velocity_mps: Point


class Route:
    """Positions of one UAV at slot beginnings, (n_slots, 2) metres; slot n begins at n * slot_s, the first at 0."""

    def __init__(self, path_m: Sequence[Point], slot_s: float) -> None:
        self.path_m = list(path_m)
        self.slot_s = slot_s

    @property
    def last(self) -> int:
        """Return the number of the last slot."""
        return len(self.path_m) - 1

    def at(self, elapsed_s: float) -> Planned:
        """Return where it should be: straight and even from slot to slot, at rest before the first and after."""
        slot = int(elapsed_s // self.slot_s)
        if elapsed_s < 0 or slot >= self.last:
            return Planned(self.path_m[0] if elapsed_s < 0 else self.path_m[-1], (0.0, 0.0))
        start, end = self.path_m[slot], self.path_m[slot + 1]
        velocity = ((end[0] - start[0]) / self.slot_s, (end[1] - start[1]) / self.slot_s)
        return Planned(between(start, end, elapsed_s / self.slot_s - slot), velocity)

    def due_s(self, slot: int) -> float:
        """Return when a slot begins."""
        return slot * self.slot_s

    def way_m(self, first: int, last: int) -> float:
        """Return the metres along the path from the beginning of one slot to that of another."""
        return sum(dist(start, end) for start, end in pairwise(self.path_m[first : last + 1]))

    def pace_mps(self, slot: int) -> float:
        """Return the mean speed of the leg that begins with a slot."""
        return self.way_m(slot, min(slot + 1, self.last)) / self.slot_s

    def rests_at(self, slot: int) -> bool:
        """Return whether the plan stays at the point of this slot for a while."""
        return slot >= self.last or self.way_m(slot, slot + 1) < SAME_PLACE_M

    def late_s(self, slot: int, point_m: Point) -> float | None:
        """Return the seconds that the missing way to a slot's point takes at the pace of the leg that ends there.

        None where the plan hardly moves in that leg: see MOVING_MPS.
        """
        (e0, n0), (e1, n1) = self.path_m[slot - 1], self.path_m[slot]
        pace_mps = self.pace_mps(slot - 1)
        if pace_mps < MOVING_MPS:
            return None
        leg_m = pace_mps * self.slot_s
        along_m = ((e1 - point_m[0]) * (e1 - e0) + (n1 - point_m[1]) * (n1 - n0)) / leg_m
        return along_m / pace_mps
