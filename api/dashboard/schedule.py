"""Where a UAV should be, and how far behind it is: pure geometry on a plan's path."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, hypot
from typing import NamedTuple

from skyfolio.mavlink_bridge.route import MOVING_MPS
from skyfolio.planner.geometry import Point, point_at

LOOK_BEHIND_SLOTS = 4.0
LOOK_AHEAD_SLOTS = 2.0
STEPS_PER_SLOT = 20
AS_NEAR_M = 1.0


class Slip(NamedTuple):
    """How far a UAV is from where the plan has it now, in metres, and behind (+) its schedule, in seconds.

    late_s: None where the plan hovers, so that a UAV in its place is on schedule.
    """

    off_m: float
    late_s: float | None


def slip(path: Sequence[Point], slot_s: float, now_s: float, here: Point) -> Slip:
    """Return the slip of a UAV at `here`; `now_s` counts from the path's first point."""
    slot = min(max(int(now_s / slot_s), 0), len(path) - 1)
    moves = dist(path[slot], path[min(slot + 1, len(path) - 1)]) >= MOVING_MPS * slot_s
    planned = point_at(path, now_s / slot_s)
    return Slip(dist(planned, here), late_s(path, slot_s, now_s, here) if moves else None)


def late_s(path: Sequence[Point], slot_s: float, now_s: float, here: Point) -> float:
    """Return the seconds behind (+) or ahead of (-) the schedule: now less the time when the path is nearest to `here`.

    `now_s` counts from the path's first point. Of times at which the path is equally near (within a metre: a hover, a
    crossing) the one closest to now counts, so that a UAV that waits in the right place has no slip.
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
