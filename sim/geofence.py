"""The geofence on board: polygons and circles to stay inside or outside of, and a cylinder around home."""

import math
from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.geo import LocalFrame, Place
from skyfolio.sim.kinematics import Body
from skyfolio.sim.missions import FENCE_CIRCLES, FENCE_POLYGONS, Mission
from skyfolio.sim.tuning import Breach, FenceRule

_KEEP_IN = (dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION)


class Fence:
    """The shapes of an uploaded fence plan; of several inclusions, it is enough to be inside one."""

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._polygons: list[tuple[bool, list[Place]]] = []
        self._circles: list[tuple[bool, Place, float]] = []

    def load(self, plan: Mission) -> None:
        """Replace the shapes by those of an accepted plan (see `sim.missions.bad_fence`)."""
        self._polygons, self._circles = [], []
        at = 0
        while at < len(plan):
            item = plan.items[at]
            run = int(item.param1) if item.command in FENCE_POLYGONS else 1
            places = [self._frame.to_local(corner.x / 1e7, corner.y / 1e7) for corner in plan.items[at : at + run]]
            if item.command in FENCE_POLYGONS:
                self._polygons.append((item.command in _KEEP_IN, places))
            elif item.command in FENCE_CIRCLES:
                self._circles.append((item.command in _KEEP_IN, places[0], item.param1))
            at += run

    def breach(self, body: Body, rule: FenceRule, home_m: Place) -> Breach | None:
        """Return which part of the fence a body breaks, or None; `home_m` is in metres east and north."""
        if body.up_m > rule.ceiling_m:
            return Breach.CEILING
        if body.distance_to(*home_m) > rule.radius_m:
            return Breach.RADIUS
        drawn = rule.shapes and (self._polygons or self._circles)
        return Breach.SHAPES if drawn and self._breaks_shapes((body.east_m, body.north_m)) else None

    def _breaks_shapes(self, place: Place) -> bool:
        has_inclusion = is_included = False
        inside = [(keep_in, _in_polygon(place, corners)) for keep_in, corners in self._polygons]
        if self._circles:
            inside += [(keep_in, math.dist(place, centre) <= radius) for keep_in, centre, radius in self._circles]
        for keep_in, within in inside:
            if keep_in:
                has_inclusion, is_included = True, is_included or within
            elif within:
                return True
        return has_inclusion and not is_included


def _in_polygon(place: Place, corners: Sequence[Place]) -> bool:
    """Return whether a place lies in a polygon, by the even-odd rule with a ray to the east."""
    crossed = False
    east, north = place
    previous_east, previous_north = corners[-1]
    previous_above = previous_north > north
    for corner_east, corner_north in corners:
        above = corner_north > north
        if above != previous_above:
            share = (north - corner_north) / (previous_north - corner_north)
            crossed ^= east < corner_east + share * (previous_east - corner_east)
        previous_east, previous_north, previous_above = corner_east, corner_north, above
    return crossed
