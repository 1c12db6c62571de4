"""A plan's path against the slot clock: where a UAV should be, and how far a way along the path is. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot

from skyfolio.mavlink_bridge.pace import Point


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
        """Number of the last slot."""
        return len(self.path_m) - 1

    def at(self, elapsed_s: float) -> Planned:
        """Straight and even from slot to slot; before the first and after the last it rests."""
        slot = int(elapsed_s // self.slot_s)
        if elapsed_s < 0 or slot >= self.last:
            return Planned(self.path_m[0] if elapsed_s < 0 else self.path_m[-1], (0.0, 0.0))
        (e0, n0), (e1, n1) = self.path_m[slot], self.path_m[slot + 1]
        share = elapsed_s / self.slot_s - slot
        velocity = ((e1 - e0) / self.slot_s, (n1 - n0) / self.slot_s)
        return Planned((e0 + share * (e1 - e0), n0 + share * (n1 - n0)), velocity)

    def due_s(self, slot: int) -> float:
        """When a slot begins."""
        return slot * self.slot_s

    def way_m(self, first: int, last: int) -> float:
        """Metres along the path from the beginning of one slot to that of another."""
        return sum(hypot(q[0] - p[0], q[1] - p[1]) for p, q in pairwise(self.path_m[first : last + 1]))
