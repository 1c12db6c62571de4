"""Where a UAV should be, and how far it is behind: pure geometry on a plan's path."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

from skyfolio.planner.geometry import Point, point_at

LOOK_BEHIND_SLOTS = 4.0
LOOK_AHEAD_SLOTS = 2.0
STEPS_PER_SLOT = 20
AS_NEAR_M = 1.0


def slip_s(path: Sequence[Point], slot_s: float, now_s: float, here: Point) -> float:
    """Seconds behind (+) or ahead of (-) the schedule: when the path passes nearest to `here`, against now.

    `now_s` counts from the path's first point. Of times that are equally near (within a metre: a hover, a crossing) the
    one closest to now counts, so a UAV that waits where it should has no slip.
    """
    now = now_s / slot_s
    span = range(int(-LOOK_BEHIND_SLOTS * STEPS_PER_SLOT), int(LOOK_AHEAD_SLOTS * STEPS_PER_SLOT) + 1)
    times = [now + step / STEPS_PER_SLOT for step in span]
    apart = [hypot(e - here[0], n - here[1]) for e, n in (point_at(path, at) for at in times)]
    near = min(apart) + AS_NEAR_M
    best = min(
        (at for at, distance in zip(times, apart, strict=True) if distance <= near), key=lambda at: abs(at - now)
    )
    return (now - best) * slot_s
