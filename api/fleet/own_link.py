"""Whether a silence is a vehicle's or our own link's. Pure: seconds of silence in, a judgement out.

When every UAV of a flight that still counts is silent at once, and no other registered vehicle is heard either, no UAV
is known to be lost: our link is. Judgement is held until a vehicle is heard again; UAVs that are still silent some time
after that are lost. A UAV that is heard at this moment is not lost, even if its link does not count as live again yet.
A flight with a single UAV left is judged the same way: there is no survivor to plan for, and nothing to gain by giving
it up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple


class Heard(NamedTuple):
    """How one vehicle is heard: fleet seconds of silence, and whether the monitor has declared it lost."""

    silent_for_s: float
    lost: bool


class OwnLink:
    """The judgement of one flight. Times are fleet seconds.

    stale_after_s: silence of all vehicles after which the link is taken to be lost. lost_after_s: how long after its
    return a UAV that stays silent is lost.
    """

    def __init__(self, *, stale_after_s: float, lost_after_s: float) -> None:
        self._stale_after_s, self._lost_after_s = stale_after_s, lost_after_s
        self.silent_since_s: float | None = None
        """Since when no vehicle was heard; None while the link is taken to work."""
        self._back_s: float | None = None

    @property
    def is_lost(self) -> bool:
        """Return whether judgement is held."""
        return self.silent_since_s is not None

    def judge(self, counting: Mapping[str, Heard], others: Iterable[Heard], now_s: float) -> list[str]:
        """Return the UAVs of `counting` that are to be declared lost now.

        counting: the UAVs that are in the air and not lost yet. others: every other registered vehicle, whatever it
        does: one that is heard shows that the link works. now_s: fleet seconds.
        """
        silent = [uav for uav, heard in counting.items() if heard.lost and heard.silent_for_s >= self._stale_after_s]
        coming_back = any(heard.lost for heard in counting.values())
        witnesses = [heard.silent_for_s for heard in (*counting.values(), *others)]
        latest_s = min(witnesses, default=0.0)
        if self.silent_since_s is None:
            if silent and latest_s >= self._stale_after_s:
                self.silent_since_s, self._back_s = now_s - latest_s, None
                return []
            return silent
        if latest_s >= self._stale_after_s:
            self._back_s = None
            return []
        if self._back_s is None:
            self._back_s = now_s - latest_s
        if coming_back and now_s - self._back_s < self._lost_after_s:
            return []
        self.silent_since_s = self._back_s = None
        return silent
