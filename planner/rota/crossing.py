"""A way over slots for one UAV from here to there while the others fly theirs: who relieves another takes it.

Routes are looked for first: straight, around no-fly zones, and around what the others sweep too, each the shortest one
(a visibility graph of the corners of what is in the way). On each route the UAV then flies as fast as it may or waits;
of all ways that keep clear the earliest arrival counts. The search is complete only on these routes: a way that it
returns is checked by the rules of a plan, but where it finds none there may still be one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from shapely import LineString, Polygon, box
from shapely import Point as GeoPoint
from shapely.geometry.base import BaseGeometry

from skyfolio.planner.arrays import Array
from skyfolio.planner.feasibility import ROUNDING_M, no_fly_depth_m
from skyfolio.planner.geometry import nearest_to_origin
from skyfolio.planner.no_fly import NoFlyDisc, NoFlyPolygon, zone_holds
from skyfolio.planner.scenario import Point, Scenario, Uav

CLEAR_M = 1.0
"""Ways keep this much more than `min_separation_m` of others, and off no-fly zones where they go around them: vehicles
do not follow their paths to the centimetre, least of all beside each other."""
SHRINK = 1.0 - 1e-9
"""A UAV flies this much below `D_max`: rounding."""
ROUND = 8
"""Corners in a quarter of a circle that is gone around."""
BESIDE = (1.5, 2.0, 3.0)
"""How far beside a station a reliever waits, in minimum separations: the nearest spot that is free."""
_TURNS_DEG = (0, 20, -20, 40, -40, 60, -60, 90, -90, 120, -120, 150, -150, 180)


class Arrival(NamedTuple):
    """A way from here to there: path_m (N, 2), metres when slots begin, at its end from slot `slot` on."""

    path_m: Array
    slot: int


def crossing(
    scenario: Scenario,
    uav: Uav,
    here_m: Point,
    there_m: Point,
    others_m: Array,
    *,
    from_slot: int = 0,
    stays: bool = True,
) -> Arrival | None:
    """Return the earliest way of `uav` that begins at `here_m` in slot `from_slot`; None where none is found.

    others_m: (V, N, 2), where the others are when slots begin, metres east/north, NaN while they are not in the air. N
    slots are looked at. stays: whether the way must be clear of others after it has arrived too, to the last slot. The
    way keeps `min_separation_m` on every leg, stays out of no-fly zones and in the area, and each step is within
    `D_max` and what the wind allows. It is written out from slot 0, waiting at `here_m` until `from_slot`.
    """
    best: Arrival | None = None
    for route in _routes(scenario, here_m, there_m, others_m[:, from_slot:]):
        stops = _stops(scenario, uav, route)
        if stops is None:
            continue
        found = _paced(scenario, stops, others_m[:, from_slot:], stays=stays)
        if found is not None and (best is None or from_slot + found.slot < best.slot):
            waiting = np.repeat(stops[:1], from_slot, axis=0)
            best = Arrival(np.concatenate([waiting, found.path_m]), from_slot + found.slot)
    return best


def beside(scenario: Scenario, station_m: Point, from_m: Point, others_m: Array) -> Iterator[Point]:
    """Yield free spots near a station, 1.5 `min_separation_m` off or more, those on the side of arrival first.

    others_m: (V, N, 2) as for `crossing`; a spot is free if none of them comes too near at any time. With no minimum
    separation there is nothing to keep off, and it is the station itself.
    """
    gap_m = scenario.min_separation_m
    if gap_m == 0.0:
        yield station_m
        return
    arrival = np.arctan2(from_m[1] - station_m[1], from_m[0] - station_m[0])
    for factor in BESIDE:
        for turn in _TURNS_DEG:
            angle = arrival + np.radians(turn)
            spot = station_m[0] + factor * gap_m * np.cos(angle), station_m[1] + factor * gap_m * np.sin(angle)
            place = float(spot[0]), float(spot[1])
            if _allowed(scenario, place) and _hover_clear(scenario, place, others_m):
                yield place


def _allowed(scenario: Scenario, place: Point) -> bool:
    (west, south), (east, north) = scenario.area_m
    inside = west <= place[0] <= east and south <= place[1] <= north
    return inside and not any(zone_holds(zone, place) for zone in scenario.no_fly)


def _hover_clear(scenario: Scenario, place: Point, others_m: Array) -> bool:
    spot = np.array([place])
    return bool(_clear_legs(scenario, spot, spot, others_m).all())


def _stops(scenario: Scenario, uav: Uav, route: Sequence[Point]) -> Array | None:
    """Return where the UAV is slot by slot when it flies a route without waiting: (S, 2) metres, a stop at each corner.

    None where the wind holds it back from one of its directions, or a leg is not allowed.
    """
    air = scenario.air_for([uav])
    stops = [np.array(route[0], dtype=float)]
    for here, there in pairwise(route):
        way = np.subtract(there, here)
        longest = uav.max_speed_mps * scenario.slot_duration_s
        if air is not None:
            longest = float(air.longest_m(way[None])[0])
        length = float(np.hypot(*way))
        if length == 0.0:
            continue
        if longest * SHRINK <= 0.0:
            return None
        steps = ceil(length / (longest * SHRINK))
        stops.extend(here + way * ((k + 1) / steps) for k in range(steps - 1))
        stops.append(np.array(there, dtype=float))
    legs = [((a[0], a[1]), (b[0], b[1])) for a, b in pairwise([row.tolist() for row in stops])]
    if any(no_fly_depth_m(zone, here, there) > ROUNDING_M for zone in scenario.no_fly for here, there in legs):
        return None
    return np.array(stops)


def _paced(scenario: Scenario, stops: Array, others_m: Array, *, stays: bool) -> Arrival | None:
    """Return the earliest way along these stops, (S, 2) metres, one further or waiting in each slot."""
    n_slots, last = others_m.shape[1], len(stops) - 1
    hover = _clear_legs(scenario, stops, stops, others_m)
    move = _clear_legs(scenario, stops[:-1], stops[1:], others_m)
    came_from: list[NDArray[np.bool_]] = []  # by slot and stop: whether it was reached by a move
    reached = np.zeros(last + 1, dtype=bool)
    reached[0] = True
    until = _free_from(hover[last]) if stays else np.zeros(n_slots, dtype=bool)
    for n in range(n_slots):
        if reached[last] and (not stays or until[n]):
            return Arrival(_written_out(stops, came_from, n, n_slots), n)
        if n == n_slots - 1:
            return None
        moved = np.concatenate([[False], reached[:-1] & move[:, n]])
        came_from.append(moved)
        reached = (reached & hover[:, n]) | moved
    return None


def _free_from(clear: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return from which slots on all slots are clear: (N,)."""
    later: NDArray[np.bool_] = np.logical_and.accumulate(clear[::-1])[::-1]
    return later


def _written_out(stops: Array, came_from: Sequence[NDArray[np.bool_]], arrived: int, n_slots: int) -> Array:
    """Return the way back from its arrival, waiting as early as can be: (N, 2) metres, at its end from then on."""
    at = len(stops) - 1
    path = np.repeat(stops[-1:], n_slots, axis=0)
    for n in range(arrived, 0, -1):
        at -= int(came_from[n - 1][at])
        path[n - 1] = stops[at]
    return path


def _clear_legs(scenario: Scenario, begins_m: Array, ends_m: Array, others_m: Array) -> NDArray[np.bool_]:
    """Return whether each leg, (S, 2) to (S, 2) metres, keeps its distance from the others in each slot: (S, N).

    In the last slot everybody stays. Where another is there only when the slot begins, or ends, that place counts.
    """
    later_m = np.concatenate([others_m[:, 1:], others_m[:, -1:]], axis=1)
    here = np.where(np.isnan(others_m), later_m, others_m)[None]
    there = np.where(np.isnan(later_m), others_m, later_m)[None]  # (1, V, N, 2)
    start = begins_m[:, None, None] - here
    nearest = nearest_to_origin(start, ends_m[:, None, None] - there - start)
    near2 = np.where(np.isnan(here).any(axis=-1), np.inf, (nearest**2).sum(axis=-1))
    least: Array = near2.min(axis=1, initial=np.inf)
    wanted_m = scenario.min_separation_m + CLEAR_M if scenario.min_separation_m > 0.0 else 0.0
    clear: NDArray[np.bool_] = least >= wanted_m**2
    return clear


def _routes(scenario: Scenario, here_m: Point, there_m: Point, others_m: Array) -> Iterator[list[Point]]:
    """Yield routes to try: straight, around zones, and around the others; each once."""
    zones = [_around(zone, here_m, there_m) for zone in scenario.no_fly]
    swept = [shape for shape in _swept(scenario, others_m) if not _holds(shape, here_m) and not _holds(shape, there_m)]
    standing = [shape for shape in swept if shape.length < _standing_m(scenario)]
    seen: list[list[Point]] = []
    for in_the_way in ([], zones, [*zones, *standing], [*zones, *swept]):
        route = _shortest(scenario, here_m, there_m, in_the_way)
        if route is not None and route not in seen:
            seen.append(route)
            yield route


def _standing_m(scenario: Scenario) -> float:
    """Return the outline, metres, of what a UAV that hovers sweeps, doubled."""
    return 4.0 * np.pi * (scenario.min_separation_m + CLEAR_M)


def _holds(shape: BaseGeometry, place: Point) -> bool:
    return bool(shape.contains(GeoPoint(place)))


def _around(zone: NoFlyDisc | NoFlyPolygon, here_m: Point, there_m: Point) -> BaseGeometry:
    """Return the outline that goes around a zone; the zone itself where one end lies between the two."""
    if isinstance(zone, NoFlyDisc):
        exact = GeoPoint(zone.center_m).buffer(zone.radius_m, quad_segs=ROUND)
        wide = GeoPoint(zone.center_m).buffer((zone.radius_m + CLEAR_M) / _inscribed(), quad_segs=ROUND)
    else:
        exact = Polygon(zone.vertices_m)
        wide = exact.buffer(CLEAR_M, join_style="mitre", mitre_limit=2.0)
    return exact if _holds(wide, here_m) or _holds(wide, there_m) else wide


def _inscribed() -> float:
    """Return the radius of the circle inside a polygon of `4 ROUND` corners, by that of its corners."""
    return float(np.cos(np.pi / (4 * ROUND)))


def _swept(scenario: Scenario, others_m: Array) -> Iterator[BaseGeometry]:
    """Yield what each other UAV sweeps, with the separation around it."""
    radius = (scenario.min_separation_m + 2 * CLEAR_M) / _inscribed()
    for path in others_m:
        flown = path[~np.isnan(path[:, 0])]
        if len(flown) and scenario.min_separation_m > 0.0:
            line = LineString(flown) if len(np.unique(flown, axis=0)) > 1 else GeoPoint(flown[0])
            yield line.buffer(radius, quad_segs=ROUND)


def _shortest(scenario: Scenario, here_m: Point, there_m: Point, shapes: Sequence[BaseGeometry]) -> list[Point] | None:
    """Return the shortest route that crosses none of the shapes; None where there is none in the area."""
    if not shapes:
        return [here_m, there_m]
    blocked = shapely.unary_union(shapes)
    solid = blocked.buffer(-CLEAR_M / 10)
    shapely.prepare(solid)
    corners = shapely.get_coordinates(blocked)
    inside = shapely.covers(box(*scenario.area_m[0], *scenario.area_m[1]), shapely.points(corners))
    nodes = np.vstack([[here_m, there_m], np.unique(corners[inside], axis=0)])
    first, second = np.triu_indices(len(nodes), k=1)
    lines = shapely.linestrings(np.stack([nodes[first], nodes[second]], axis=1))
    free = ~shapely.intersects(solid, lines)
    first, second = first[free], second[free]
    length = np.linalg.norm(nodes[first] - nodes[second], axis=1) + CLEAR_M / 10  # fewer corners first
    graph = csr_array((length, (first, second)), shape=(len(nodes), len(nodes)))
    away, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    if not np.isfinite(away[1]):
        return None
    back = [1]
    while back[-1] != 0:
        back.append(int(before[back[-1]]))
    return [(float(nodes[k][0]), float(nodes[k][1])) for k in reversed(back)]
