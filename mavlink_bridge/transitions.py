"""Do UAVs keep apart while they change over to a new plan? From where they really are, ghosts included. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from math import hypot

from mavlink_bridge.errors import TransitionTooClose
from mavlink_bridge.ghosts import Airspace
from mavlink_bridge.pace import Point


def check_transition(
    live_m: Mapping[str, Point],
    paths_m: Mapping[str, Sequence[Point]],
    *,
    now_s: float,
    first_due_s: float,
    slot_s: float,
    required_m: float,
    airspace: Airspace | None = None,
) -> None:
    """Raise TransitionTooClose if two UAVs, or a UAV and a ghost, come closer than `required_m`.

    live_m: where each UAV is at `now_s`, metres east/north; one that does not fly the new plan stays where it is.
    paths_m: where each should be at `first_due_s` and every `slot_s` after it. Legs are flown straight and evenly.
    """
    ways = {uav: [live_m[uav], *paths_m.get(uav, ())] for uav in live_m}
    longest = max((len(way) for way in ways.values()), default=1)
    times_s = [now_s, *(first_due_s + n * slot_s for n in range(longest - 1))]
    padded = {uav: way + [way[-1]] * (longest - len(way)) for uav, way in ways.items()}
    for first, second in combinations(padded, 2):
        apart_m, at_s = _closest(padded[first], padded[second], times_s)
        if apart_m < required_m:
            raise TransitionTooClose(
                f"'{first}' and '{second}' would come within {apart_m:.2f} m at {at_s:.1f} s", required_m
            )
    if airspace is not None:
        for conflict in airspace.conflicts(padded, times_s, required_m):
            raise TransitionTooClose(str(conflict), required_m)


def _closest(first: Sequence[Point], second: Sequence[Point], times_s: Sequence[float]) -> tuple[float, float]:
    """(least distance in metres, when) of two UAVs that fly straight between the same times."""
    least, when = float("inf"), times_s[0]
    between = [(a[0] - b[0], a[1] - b[1]) for a, b in zip(first, second, strict=True)]
    if len(between) == 1:
        return hypot(*between[0]), when
    for (start, end), (begin_s, end_s) in zip(pairwise(between), pairwise(times_s), strict=True):
        change = (end[0] - start[0], end[1] - start[1])
        length2 = change[0] ** 2 + change[1] ** 2
        along = 0.0 if length2 == 0 else -(start[0] * change[0] + start[1] * change[1]) / length2
        share = min(1.0, max(0.0, along))
        apart = hypot(start[0] + share * change[0], start[1] + share * change[1])
        if apart < least:
            least, when = apart, begin_s + share * (end_s - begin_s)
    return least, when
