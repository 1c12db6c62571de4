"""The ghost rule: a lost UAV still flies, so its old route and its way home stay reserved air. Pure.

An aircraft whose link is lost usually flies its mission to the end, hovers where it was, or returns home. So until it
is seen on the ground, or a deadline passes, no other UAV may come closer than `min_separation_m` to where its old plan
has it at that moment, to where it was last seen, or to any point of the straight ways from its route to its home or
a rally point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist
from typing import Any

from skyfolio.mavlink_bridge.plane import Segment, segment_distances_m
from skyfolio.mavlink_bridge.route import Route
from skyfolio.planner.geometry import Point, between

DEADLINE_S = 30 * 60.0
"""No battery of the class that is flown lasts longer than this in the air: after it the air is free again."""
SAMPLE_S = 0.5
_STORED = ("uav_id", "lost_at_s", "last_seen_m", "home_m", "deadline_s", "rally_m")


@dataclass(frozen=True, kw_only=True)
class Way:
    """A route that may be flown, its slot 0 at `began_s`, fleet seconds since the operation's slot 0."""

    route: Route
    began_s: float

    def at_m(self, now_s: float) -> Point:
        """Return where a UAV is that flies it on schedule."""
        return self.route.at(now_s - self.began_s).point_m


@dataclass(frozen=True, kw_only=True)
class Ghost:
    """One lost UAV. Times are fleet seconds since the operation's slot 0; places metres east/north.

    `ways`: the routes it may fly; more than one if it is not known which mission it has. `home_m` is where it took off,
    None if unknown; `rally_m`: where it may land instead.
    """

    uav_id: str
    lost_at_s: float
    last_seen_m: Point
    ways: tuple[Way, ...]
    home_m: Point | None
    deadline_s: float
    rally_m: tuple[Point, ...] = ()

    @property
    def ways_home(self) -> list[Segment]:
        """The lines to its home and rally points: from where it was last seen, and from the end of each route."""
        starts = (self.last_seen_m, *(way.route.path_m[-1] for way in self.ways))
        ends = [*(() if self.home_m is None else (self.home_m,)), *self.rally_m]
        return [(start, end) for start in starts for end in ends]


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
    """The reserved air of lost UAVs: this operation's, and through `elsewhere` that of others."""

    def __init__(self) -> None:
        self._ghosts: dict[str, Ghost] = {}
        self.elsewhere: Callable[[], Iterable[Ghost]] = tuple
        """Returns the ghosts of other operations, on the same clock and from the same origin."""

    @property
    def ghosts(self) -> Mapping[str, Ghost]:
        """Return the ghosts by UAV id."""
        return dict(self._ghosts)

    def reserve(self, ghost: Ghost) -> None:
        """Reserve its air from now on."""
        self._ghosts.setdefault(ghost.uav_id, ghost)

    def seen(self, uav_id: str, at_m: Point) -> None:
        """Take in that a UAV whose air is reserved is heard: its last place is `at_m` now, metres east/north."""
        ghost = self._ghosts.get(uav_id)
        if ghost is not None:
            self._ghosts[uav_id] = replace(ghost, last_seen_m=at_m)

    def release(self, uav_id: str) -> None:
        """Free its air: it was seen on the ground, or is back."""
        self._ghosts.pop(uav_id, None)

    def expire(self, now_s: float) -> list[str]:
        """Free the air of ghosts that are past their deadline, and return their UAV ids."""
        gone = [uav for uav, ghost in self._ghosts.items() if now_s >= ghost.deadline_s]
        for uav in gone:
            self.release(uav)
        return gone

    def document(self) -> list[dict[str, Any]]:
        """Return the ghosts as JSON values, for `recall` after a restart."""
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
        for stored in document:
            home, rally = stored["home_m"], stored.get("rally_m", ())
            places = {
                "last_seen_m": tuple(stored["last_seen_m"]),
                "home_m": None if home is None else tuple(home),
                "rally_m": tuple((east, north) for east, north in rally),
            }
            self.reserve(
                Ghost(**{name: stored[name] for name in _STORED if name in stored} | places, ways=tuple(_ways(stored)))
            )

    def conflicts(
        self, paths_m: Mapping[str, Sequence[Point]], times_s: Sequence[float], required_m: float
    ) -> list[Conflict]:
        """Return where these paths, flown straight between the times, come closest to a ghost, if that is too close.

        paths_m: (n, 2) metres east/north for each UAV; times_s: (n,) fleet seconds since the operation's slot 0.
        """
        conflicts = []
        ghosts = [*self._ghosts.values(), *self.elsewhere()]
        for uav_id, path in paths_m.items():
            for ghost in ghosts:
                worst = min(_approaches(uav_id, path, times_s, ghost), key=lambda c: c.apart_m, default=None)
                if worst is not None and worst.apart_m < required_m:
                    conflicts.append(worst)
        return conflicts


def _approaches(uav_id: str, path_m: Sequence[Point], times_s: Sequence[float], ghost: Ghost) -> Iterable[Conflict]:
    """Yield the least distances, leg by leg, for each way a ghost may behave."""
    legs = list(pairwise(path_m))
    lasting = [("the last place", (ghost.last_seen_m, ghost.last_seen_m))]
    lasting += [("the way home", way) for way in ghost.ways_home]
    apart_m = [segment_distances_m(legs, [segment]).tolist() for _, segment in lasting]
    for leg, ((start, end), (begin_s, end_s)) in enumerate(zip(legs, pairwise(times_s), strict=True)):
        for (because, _), distances_m in zip(lasting, apart_m, strict=True):
            yield _conflict(uav_id, ghost, begin_s, distances_m[leg], because)
        yield from _at_the_same_time(uav_id, start, end, begin_s, end_s, ghost)


def _at_the_same_time(
    uav_id: str, start: Point, end: Point, begin_s: float, end_s: float, ghost: Ghost
) -> Iterable[Conflict]:
    steps = max(1, round((end_s - begin_s) / SAMPLE_S))
    for step in range(steps + 1):
        share = step / steps
        at_s = begin_s + share * (end_s - begin_s)
        here = between(start, end, share)
        for way in ghost.ways:
            yield _conflict(uav_id, ghost, at_s, dist(here, way.at_m(at_s)), "the old route")


def _ways(stored: Mapping[str, Any]) -> Iterable[Way]:
    """Yield the ways in a document; an older one has a single way beside the other values."""
    for way in stored.get("ways") or [{**stored, "began_s": stored["route_began_s"]}]:
        route = Route([(east, north) for east, north in way["path_m"]], way["slot_s"])
        yield Way(route=route, began_s=way["began_s"])


def _conflict(uav_id: str, ghost: Ghost, at_s: float, apart_m: float, because: str) -> Conflict:
    return Conflict(uav_id=uav_id, ghost_id=ghost.uav_id, at_s=at_s, apart_m=apart_m, because=because)
