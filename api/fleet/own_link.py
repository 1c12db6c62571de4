"""Whether a silence is a vehicle's or our own link's. Pure: seconds of silence in, a judgement out.

When every UAV of a flight that still counts is silent at once, and no other registered vehicle is heard either, nobody
was lost as far as we can know: it is our link that is gone. Judgement is held until somebody is heard again; whoever is
still silent some time after that is lost. A flight with a single UAV left is judged the same way: there is nobody to
plan for, and nothing to gain by giving it up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class Heard:
    """How one vehicle is heard: fleet seconds since it was, and whether the monitor has declared it lost."""

    silent_for_s: float
    lost: bool


class OwnLink:
    """One flight's judgement. Times are fleet seconds."""

    def __init__(self, *, stale_after_s: float, lost_after_s: float) -> None:
        self._stale_after_s, self._lost_after_s = stale_after_s, lost_after_s
        self.silent_since_s: float | None = None
        """Since when nobody was heard; None while the link is taken to work."""
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
        silent = [uav for uav, heard in counting.items() if heard.lost]
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
        if silent and now_s - self._back_s < self._lost_after_s:
            return []
        self.silent_since_s = self._back_s = None
        return silent
