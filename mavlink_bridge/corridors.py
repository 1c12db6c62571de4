"""The air that UAVs sweep at any time: what has to be kept apart when two clocks have nothing in common. Pure.

Two operations begin, pause and replan independently. So they are kept apart not by when a UAV is somewhere but by where
it may be at all: the whole rest of its route, at its height, and at every height the places where it climbs, lands, or
flies home.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import shapely

from skyfolio.planner.geometry import Point

Mapped = Callable[[Point], Point]


@dataclass(frozen=True, kw_only=True)
class Corridor:
    """The air of one UAV; metres east/north of the one origin that all compared corridors share.

    level_m: a line that is flown at `height_m` above sea level (None: at an unknown height), or, where heights differ
    along it, between there and `top_m`. upright_m: lines that are
    flown at any height, single points included. owner: the operation it flies for, in words.
    """

    uav_id: str
    owner: str
    required_m: float
    level_m: Sequence[Point] = ()
    height_m: float | None = None
    top_m: float | None = None
    upright_m: tuple[Sequence[Point], ...] = ()

    def mapped(self, to: Mapped) -> Corridor:
        """Return the same air, seen from another origin."""
        return replace(
            self,
            level_m=[to(point) for point in self.level_m],
            upright_m=tuple([to(point) for point in line] for line in self.upright_m),
        )


@dataclass(frozen=True, kw_only=True)
class Meeting:
    """Two UAVs could come closer than `required_m`: as close as `apart_m` metres."""

    first: Corridor
    second: Corridor
    apart_m: float
    required_m: float

    def __str__(self) -> str:
        return (
            f"'{self.first.uav_id}' could come within {self.apart_m:.1f} m of '{self.second.uav_id}' of "
            f"{self.second.owner}; {self.required_m:g} m are asked for"
        )


def meetings(ours: Iterable[Corridor], others: Iterable[Corridor], slack_m: float = 0.0) -> list[Meeting]:
    """Return each pair of own and other corridors that could meet; each pair keeps the larger distance of the two.

    slack_m: how much less than the distance is accepted as rounding.
    """
    shapes = [(corridor, *_shapes(corridor)) for corridor in others]
    close_pairs = []
    for own in ours:
        level, upright = _shapes(own)
        for other, other_level, other_upright in shapes:
            required_m = max(own.required_m, other.required_m)
            pairs = [(level, other_upright), (upright, other_level), (upright, other_upright)]
            if not _one_above_the_other(own, other, required_m):
                pairs.append((level, other_level))
            near = [shapely.distance(a, b) for a, b in pairs if shapely.dwithin(a, b, required_m - slack_m)]
            near = [float(apart_m) for apart_m in near if apart_m < required_m - slack_m]
            if near:
                close_pairs.append(Meeting(first=own, second=other, apart_m=min(near), required_m=required_m))
    return close_pairs


def _one_above_the_other(first: Corridor, second: Corridor, required_m: float) -> bool:
    if first.height_m is None or second.height_m is None:
        return False
    first_top_m = first.height_m if first.top_m is None else first.top_m
    second_top_m = second.height_m if second.top_m is None else second.top_m
    return max(second.height_m - first_top_m, first.height_m - second_top_m) >= required_m


def _shapes(corridor: Corridor) -> tuple[Any, Any]:
    """Return the level line and the upright ones, either of them empty if there is none."""
    level = _line(corridor.level_m) if corridor.level_m else shapely.GeometryCollection()
    upright = shapely.GeometryCollection([_line(line) for line in corridor.upright_m if line])
    for shape in (level, upright):
        shapely.prepare(shape)
    return level, upright


def _line(points: Sequence[Point]) -> Any:
    return shapely.Point(points[0]) if len(set(points)) == 1 else shapely.LineString(points)
