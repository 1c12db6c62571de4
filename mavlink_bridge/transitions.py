"""Check that UAVs keep apart while they change to a new plan, from where they really are, ghosts included. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skyfolio.mavlink_bridge.errors import TransitionTooClose
from skyfolio.mavlink_bridge.ghosts import Airspace
from skyfolio.planner.arrays import Array
from skyfolio.planner.geometry import Point


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
    if len(padded) > 1:
        _require_apart(padded, times_s, required_m)
    if airspace is not None:
        for conflict in airspace.conflicts(padded, times_s, required_m):
            raise TransitionTooClose(str(conflict), required_m)


def _require_apart(ways_m: Mapping[str, Sequence[Point]], times_s: Sequence[float], required_m: float) -> None:
    """Raise TransitionTooClose for the first two UAVs that come too close, flying straight between the same times."""
    names, places = list(ways_m), np.array(list(ways_m.values()), dtype=float)  # (n_uavs, n_times, 2)
    for number, first in enumerate(names[:-1]):
        apart_m, shares = _least_apart(places[number] - places[number + 1 :])
        least_m = apart_m.min(axis=1)
        if (least_m < required_m).any():
            other = int(np.argmax(least_m < required_m))
            leg = int(np.argmin(apart_m[other]))
            begin_s, end_s = times_s[leg], times_s[min(leg + 1, len(times_s) - 1)]
            at_s = begin_s + shares[other, leg] * (end_s - begin_s)
            raise TransitionTooClose(
                f"'{first}' and '{names[number + 1 + other]}' would come within {least_m[other]:.2f} m at {at_s:.1f} s",
                required_m,
            )


def _least_apart(between_m: Array) -> tuple[Array, Array]:
    """Return the least distance on each leg, metres, and at which share of it it is reached.

    between_m: (n, n_times, 2), from one UAV to each of n others at each time, metres east/north. Returns two arrays of
    (n, n_times - 1), or (n, 1) of one time.
    """
    if between_m.shape[1] == 1:
        return np.hypot(between_m[..., 0], between_m[..., 1]), np.zeros(between_m.shape[:2])
    start, change = between_m[:, :-1], np.diff(between_m, axis=1)
    length2 = (change**2).sum(axis=2)
    along = -(start * change).sum(axis=2)
    shares = np.clip(np.divide(along, length2, out=np.zeros_like(along), where=length2 > 0), 0.0, 1.0)
    nearest = start + shares[..., None] * change
    return np.hypot(nearest[..., 0], nearest[..., 1]), shares
