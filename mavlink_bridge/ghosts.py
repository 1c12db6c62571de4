"""The ghost rule: a UAV we lost sight of still flies. Its old route and its way home stay reserved air. Pure.

A link-lost aircraft usually flies its mission to the end, hovers where it was, or returns home. So until it is seen on
the ground, or a deadline passes, no other UAV may come closer than `min_separation_m` to where its old plan has it at
that moment, to where it was last seen, or to any point of the straight way from its route to its home.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot
from typing import Any

from skyfolio.mavlink_bridge.pace import Point
from skyfolio.mavlink_bridge.returns import segment_distance_m
from skyfolio.mavlink_bridge.route import Route

DEADLINE_S = 30 * 60.0
"""After this long in the air no battery of the class we fly lasts: the air is free again."""
SAMPLE_S = 0.5
_STORED = ("uav_id", "lost_at_s", "last_seen_m", "home_m", "deadline_s")


@dataclass(frozen=True, kw_only=True)
class Way:
    """A route that may be flown, its slot 0 at `began_s`, fleet seconds since the operation's slot 0."""

    route: Route
    began_s: float

    def at_m(self, now_s: float) -> Point:
        """Where a UAV is that flies it on schedule."""
        return self.route.at(now_s - self.began_s).point_m


@dataclass(frozen=True, kw_only=True)
class Ghost:
    """One UAV we lost. Times are fleet seconds since the operation's slot 0; places metres east/north.

    `ways`: what the mission on board flies, and several where it is not known which is. `home_m` is where it took off,
    None if unknown.
    """

    uav_id: str
    lost_at_s: float
    last_seen_m: Point
    ways: tuple[Way, ...]
    home_m: Point | None
    deadline_s: float


@dataclass(frozen=True, kw_only=True)
class Conflict:
    """A UAV would come too close to a ghost, at a time, in one of the ways a ghost may behave."""

    uav_id: str
    ghost_id: str
    at_s: float
    apart_m: float
    because: str

    def __str__(self) -> str:
        return (
            f"'{self.uav_id}' would come within {self.apart_m:.1f} m of {self.because} of '{self.ghost_id}' "
            f"at {self.at_s:.1f} s"
        )


class Airspace:
    """Reserved air of the UAVs we lost, and sight of that of UAVs which others have."""

    def __init__(self) -> None:
        self._ghosts: dict[str, Ghost] = {}
        self.elsewhere: Callable[[], Iterable[Ghost]] = tuple
        """Tells of UAVs that others have lost, on the same clock and from the same origin."""

    @property
    def ghosts(self) -> Mapping[str, Ghost]:
        """By UAV id."""
        return dict(self._ghosts)

    def reserve(self, ghost: Ghost) -> None:
        """From now on its air is taken."""
        self._ghosts.setdefault(ghost.uav_id, ghost)

    def seen(self, uav_id: str, at_m: Point) -> None:
        """One whose air is reserved is still heard, or again: the last place is there now, metres east/north."""
        ghost = self._ghosts.get(uav_id)
        if ghost is not None:
            self._ghosts[uav_id] = replace(ghost, last_seen_m=at_m)

    def release(self, uav_id: str) -> None:
        """It was seen on the ground, or is back."""
        self._ghosts.pop(uav_id, None)

    def expire(self, now_s: float) -> list[str]:
        """Free what is past its deadline; the UAV ids."""
        gone = [uav for uav, ghost in self._ghosts.items() if now_s >= ghost.deadline_s]
        for uav in gone:
            self.release(uav)
        return gone

    def document(self) -> list[dict[str, Any]]:
        """The ghosts as JSON values, for `recall` after a restart."""
        return [
            {name: getattr(ghost, name) for name in _STORED}
            | {
                "ways": [
                    {"path_m": way.route.path_m, "slot_s": way.route.slot_s, "began_s": way.began_s}
                    for way in ghost.ways
                ]
            }
            for ghost in self._ghosts.values()
        ]

    def recall(self, document: Iterable[Mapping[str, Any]]) -> None:
        """Reserve again what `document` wrote."""
        for said in document:
            home = said["home_m"]
            places = {"last_seen_m": tuple(said["last_seen_m"]), "home_m": None if home is None else tuple(home)}
            self.reserve(Ghost(**{name: said[name] for name in _STORED} | places, ways=tuple(_ways(said))))

    def conflicts(
        self, paths_m: Mapping[str, Sequence[Point]], times_s: Sequence[float], required_m: float
    ) -> list[Conflict]:
        """Where these paths, flown straight between the times, come too close to a ghost; the closest of each pair."""
        found = []
        ghosts = [*self._ghosts.values(), *self.elsewhere()]
        for uav_id, path in paths_m.items():
            for ghost in ghosts:
                worst = min(_approaches(uav_id, path, times_s, ghost), key=lambda c: c.apart_m, default=None)
                if worst is not None and worst.apart_m < required_m:
                    found.append(worst)
        return found


def _approaches(uav_id: str, path_m: Sequence[Point], times_s: Sequence[float], ghost: Ghost) -> Iterable[Conflict]:
    """The least distances, leg by leg, for each way a ghost may behave."""
    ways_home = [] if ghost.home_m is None else _ways_home(ghost)
    for (start, end), (begin_s, end_s) in zip(pairwise(path_m), pairwise(times_s), strict=True):
        hover = segment_distance_m((start, end), (ghost.last_seen_m, ghost.last_seen_m))
        yield _conflict(uav_id, ghost, begin_s, hover, "the last place")
        for way in ways_home:
            yield _conflict(uav_id, ghost, begin_s, segment_distance_m((start, end), way), "the way home")
        yield from _at_the_same_time(uav_id, start, end, begin_s, end_s, ghost)


def _at_the_same_time(
    uav_id: str, start: Point, end: Point, begin_s: float, end_s: float, ghost: Ghost
) -> Iterable[Conflict]:
    steps = max(1, round((end_s - begin_s) / SAMPLE_S))
    for step in range(steps + 1):
        share = step / steps
        at_s = begin_s + share * (end_s - begin_s)
        here = (start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
        for way in ghost.ways:
            there = way.at_m(at_s)
            yield _conflict(uav_id, ghost, at_s, hypot(here[0] - there[0], here[1] - there[1]), "the old route")


def _ways_home(ghost: Ghost) -> list[tuple[Point, Point]]:
    """From where it was last seen, and from the end of its route: it returns when its failsafe acts, or at the end."""
    assert ghost.home_m is not None  # noqa: S101
    return [(start_m, ghost.home_m) for start_m in (ghost.last_seen_m, *(way.route.path_m[-1] for way in ghost.ways))]


def _ways(said: Mapping[str, Any]) -> Iterable[Way]:
    """What `document` wrote of a ghost's ways; before there could be several, it wrote the one way beside the rest."""
    for way in said.get("ways") or [{**said, "began_s": said["route_began_s"]}]:
        route = Route([(east, north) for east, north in way["path_m"]], way["slot_s"])
        yield Way(route=route, began_s=way["began_s"])


def _conflict(uav_id: str, ghost: Ghost, at_s: float, apart_m: float, because: str) -> Conflict:
    return Conflict(uav_id=uav_id, ghost_id=ghost.uav_id, at_s=at_s, apart_m=apart_m, because=because)
