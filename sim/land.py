"""The ground under a vehicle, where it is not level: what it stands on, lands on, and can fly into."""

from typing import Protocol

from skyfolio.planner.geodesy import geodetic_to_east_north
from skyfolio.planner.parts import Origin
from skyfolio.planner.terrain import Terrain
from skyfolio.sim.geo import LocalFrame, Place


class Land(Protocol):
    """Ground heights around one vehicle."""

    def up_m(self, place: Place) -> float:
        """Return the ground at metres east and north of the spawn point, in metres above the ground there."""


class Level:
    """Level ground everywhere."""

    def up_m(self, place: Place) -> float:  # noqa: ARG002 - alike everywhere
        """Return 0."""
        return 0.0


class Hills:
    """Ground by a grid of heights above sea level; metres east/north of `origin`, as scenarios have them."""

    def __init__(self, terrain: Terrain, origin: Origin) -> None:
        self._terrain, self._origin = terrain, origin

    def amsl_m(self, lat_deg: float, lon_deg: float) -> float:
        """Return the height of the ground at a point given in degrees, metres above mean sea level."""
        return self._terrain.height_at(*geodetic_to_east_north(self._origin, lat_deg, lon_deg))

    def around(self, frame: LocalFrame, home_alt_m: float) -> Land:
        """Return the ground as a vehicle has it that was put down at the origin of `frame`, at this height."""
        return _Around(self, frame, home_alt_m)


class _Around:
    def __init__(self, hills: Hills, frame: LocalFrame, home_alt_m: float) -> None:
        self._hills, self._frame, self._home_alt_m = hills, frame, home_alt_m

    def up_m(self, place: Place) -> float:
        return self._hills.amsl_m(*self._frame.to_geodetic(*place)) - self._home_alt_m
