"""Where every UAV was during a flight, in as little memory as a long flight of a large fleet needs.

Of a flight without an end the newest part is kept: samples keep their numbers when older ones are forgotten.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from math import isnan, nan
from typing import overload

from skyfolio.planner.geometry import Point

Seen = tuple[float, dict[str, Point]]
"""Fleet seconds since slot 0, and metres east/north of each UAV that was heard."""


class Track(Sequence[Seen]):
    """Samples of these UAVs, the oldest first: 16 bytes for each UAV and sample. Other UAVs are not recorded."""

    def __init__(self, uav_ids: Iterable[str]) -> None:
        self._uavs = tuple(uav_ids)
        self._at_s, self._places_m = array("d"), array("d")
        self.first = 0
        """The number of the oldest sample that is kept."""

    @property
    def end(self) -> int:
        """Return the number of the sample that comes next."""
        return self.first + len(self)

    def numbered(self, number: int) -> Seen:
        """Return the sample of this number, which must not be forgotten."""
        return self[number - self.first]

    def since(self, number: int) -> list[Seen]:
        """Return the samples from this number on, as far as they are kept."""
        return self[max(number - self.first, 0) :]

    def between(self, from_s: float, to_s: float) -> list[Seen]:
        """Return the samples from one fleet second on and before another."""
        return self[bisect_left(self._at_s, from_s) : bisect_left(self._at_s, to_s)]

    def forget_before(self, at_s: float) -> None:
        """Forget the samples from before that fleet second."""
        count = bisect_left(self._at_s, at_s)
        del self._at_s[:count]
        del self._places_m[: count * 2 * len(self._uavs)]
        self.first += count

    def append(self, at_s: float, positions_m: Mapping[str, Point]) -> None:
        """Add where each UAV that was heard is, `at_s` fleet seconds after slot 0 began."""
        self._at_s.append(at_s)
        for uav in self._uavs:
            self._places_m.extend(positions_m.get(uav, (nan, nan)))

    def __len__(self) -> int:
        return len(self._at_s)

    @overload
    def __getitem__(self, index: int) -> Seen: ...
    @overload
    def __getitem__(self, index: slice) -> list[Seen]: ...
    def __getitem__(self, index: int | slice) -> Seen | list[Seen]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        at_s, begin = self._at_s[index], index % len(self) * 2 * len(self._uavs)
        row = self._places_m[begin : begin + 2 * len(self._uavs)]
        places = zip(self._uavs, row[::2], row[1::2], strict=True)
        return at_s, {uav: (east, north) for uav, east, north in places if not isnan(east)}

    def still_since_s(self, uav: str) -> float | None:
        """Return the fleet second since which the last known place of a UAV is the same; None if it was never heard.

        It was last heard then, or later: a sample repeats the place of one that is silent.
        """
        since_s: float | None = None
        last: tuple[float, float] | None = None
        width, begin = 2 * len(self._uavs), 2 * self._uavs.index(uav)
        for number in range(len(self) - 1, -1, -1):
            east, north = self._places_m[number * width + begin], self._places_m[number * width + begin + 1]
            if isnan(east) or (last is not None and (east, north) != last):
                break
            since_s, last = self._at_s[number], (east, north)
        return since_s

    def at_s(self, index: int) -> float:
        """Return the fleet second of that sample."""
        return self._at_s[index]
